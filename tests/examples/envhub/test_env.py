"""The entry of LeRobot's EnvHub: its documented contract, the same as exported data sets, and LeRobot itself."""

import importlib.util
import json
import os
import subprocess
from pathlib import Path
from types import ModuleType, SimpleNamespace

import gymnasium
import numpy as np
import pytest

from pipeline.episodes.export.layout import common_layout, open_episode
from pipeline.recording.record import record_episode
from tests.cathsim.equal_observations import same

PROJECT_ROOT = Path(__file__).resolve().parents[3]
ENTRY = PROJECT_ROOT / "examples" / "envhub" / "env.py"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
LEROBOT = Path(os.environ.get("LEROBOT_PYTHON") or CACHE / "endonav" / "lerobot" / "bin" / "python")
EVALUATION = Path(__file__).with_name("lerobot_rollout.py")
NEAR = "point_50.0_12.0_-70.0_mm"  # in front of the sheath
FORWARD = np.array([1.0, 0.0], np.float32)


@pytest.fixture(scope="module")
def entry() -> ModuleType:
    """The module as LeRobot loads it, from its path alone."""
    spec = importlib.util.spec_from_file_location("hub_env_user_repository", ENTRY)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_task_has_a_vector(entry: ModuleType) -> None:
    made = entry.make_env(n_envs=2, accuracy="fast", image_size=40)
    assert {suite: list(tasks) for suite, tasks in made.items()} == {"cathsim": [0, 1]}
    vector = made["cathsim"][1]
    assert isinstance(vector, gymnasium.vector.SyncVectorEnv)
    assert vector.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP
    assert vector.call("task_description") == ("reach the lcca in type_1",) * 2
    assert vector.call("_max_episode_steps") == (300, 300)
    observation, info = vector.reset(seed=[0, 1])
    assert observation["pixels"]["frontal"].shape == (2, 40, 40, 3)
    assert observation["pixels"]["frontal"].dtype == np.uint8
    assert observation["agent_pos"].shape == (2, 6)
    assert observation["environment_state"].shape == (2, 3)
    assert info["is_success"].tolist() == [False, False]
    assert vector.observation_space.contains(observation)
    assert vector.envs[0].render().shape == (40, 40, 3)
    for one in made["cathsim"].values():
        one.close()


def test_an_episode_restarts_in_the_step_that_ends_it(entry: ModuleType) -> None:
    cfg = SimpleNamespace(task=f"type_1/{NEAR}")
    vector = entry.make_env(n_envs=1, cfg=cfg, accuracy="fast", image_size=32)["cathsim"][0]
    start, _ = vector.reset(seed=0)
    for _ in range(40):
        observation, _, terminated, _, info = vector.step(FORWARD[None])
        if terminated[0]:
            break
    assert info["final_info"]["is_success"].tolist() == [True]
    last = info["final_obs"][0]["agent_pos"]
    assert np.linalg.norm(last[:3] - observation["environment_state"][0]) < 0.008
    np.testing.assert_allclose(observation["agent_pos"], start["agent_pos"], atol=2e-3)  # at the start again
    vector.close()


def test_processes_give_the_same(entry: ModuleType) -> None:
    cfg = SimpleNamespace(task="type_1/bca")
    vectors = [entry.make_env(1, use, cfg, accuracy="fast", image_size=32)["cathsim"][0] for use in (False, True)]
    assert isinstance(vectors[1], gymnasium.vector.AsyncVectorEnv)
    one, other = ([vector.reset(seed=3)[0], vector.step(FORWARD[None])[0]] for vector in vectors)
    assert all(same(*pair) for pair in zip(one, other, strict=True))
    for vector in vectors:
        vector.close()


@pytest.mark.parametrize("catheter", [None, "vertebral"])
def test_observations_are_those_of_an_exported_data_set(
    entry: ModuleType, catheter: str | None, tmp_path: Path
) -> None:
    env = entry.PixelsEnv("type_1", "bca", catheter=catheter, accuracy="fast", image_size=32, max_steps=4)
    actions = iter(np.random.default_rng(0).uniform(0, 1, (4, *env.action_space.shape)).astype(np.float32))
    seen = []

    def policy(observation: dict[str, np.ndarray], info: object) -> np.ndarray:
        seen.append(env._seen(observation))
        return next(actions)

    record_episode(env.env, policy, tmp_path / "0.mcap", seed=0, operator="test")
    with open_episode(tmp_path / "0.mcap", common_layout([tmp_path / "0.mcap"])) as episode:
        for step, (one, picture) in enumerate(zip(seen, episode.pictures("frontal"), strict=False)):
            state = np.concatenate([episode.observations[name][step] for name in ("tip", "feeder")])
            np.testing.assert_array_equal(one["agent_pos"], state.astype(np.float32))
            np.testing.assert_allclose(one["environment_state"], episode.observations["goal"][step], rtol=1e-6)
            np.testing.assert_array_equal(one["pixels"]["frontal"][..., 1], picture)
            assert env.observation_space.contains(one)
    assert len(seen) == 4


def test_wrong_arguments_are_refused(entry: ModuleType) -> None:
    with pytest.raises(ValueError, match="n_envs must be at least 1, got 0"):
        entry.make_env(n_envs=0)
    with pytest.raises(ValueError, match="a task is PHANTOM/TARGET, such as type_1/bca, got 'bca'"):
        entry.make_env(cfg=SimpleNamespace(task="bca"))


@pytest.mark.slow
def test_lerobot_evaluates_a_policy(tmp_path: Path) -> None:
    if not LEROBOT.is_file():
        pytest.skip(f"no environment with LeRobot at {LEROBOT}: `make lerobot` makes one (8 GB), or set LEROBOT_PYTHON")
    path = os.pathsep.join((str(PROJECT_ROOT / "packages" / "cathsim" / "src"), os.environ.get("PYTHONPATH", "")))
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hub"), "PYTHONPATH": path}
    command = [str(LEROBOT), str(EVALUATION), str(ENTRY), f"type_1/{NEAR}"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["success"] == [True, True]
    assert result["images"] == [1, 3, 32, 32]
    assert result["task"] == f"reach the {NEAR} in type_1"
