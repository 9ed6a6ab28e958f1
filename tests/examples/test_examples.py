"""Every example runs and gives what it says."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import SAC, HerReplayBuffer

from cathsim import load_phantom
from pipeline.episodes import EpisodeReader

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def example(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module of an example; on the path, so that its own processes find it."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.delitem(sys.modules, request.param, raising=False)
    return importlib.import_module(request.param)


def of(name: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("example", [name], indirect=True)


def test_every_example_has_a_test() -> None:
    own = {f"own_{name}" for name in ("anatomy", "policy", "reward", "data", "xray_pair")}
    assert {path.stem for path in EXAMPLES.glob("*.py")} == own | {"shown_by_policies", "sweep", "her"}


@of("own_anatomy")
def test_an_arch_of_own_measures_and_a_mesh_are_entered(example: ModuleType, tmp_path: Path) -> None:
    assert example.main(steps=20)["insertion"] == pytest.approx(0.04, abs=0.002)
    mesh = tmp_path / "arch.stl"
    load_phantom("type_1", resolution=2e-3).lumen_mesh.export(mesh)
    assert example.main(str(mesh), steps=5)["insertion"] == pytest.approx(0.01, abs=0.002)


@of("own_policy")
def test_a_policy_is_scored(example: ModuleType) -> None:
    summary = example.main(episodes=2, steps=30)
    assert summary.episodes == 2
    assert summary.episode_length_steps.mean == 30
    policy = example.TurnWhenStuck(seed=0)
    actions = [policy({"distance": 0.1})[0] for _ in range(24)]
    assert actions[:5] == [1.0] * 5, "fed at first"
    assert -1.0 in actions, "drawn back when the tip comes no nearer"


@of("own_reward")
def test_the_reward_is_that_of_the_step(example: ModuleType) -> None:
    info = {"progress": 0.002, "force": 0.05, "action": [1.0, -0.5]}
    assert example.gentle_progress(info) == pytest.approx(0.2 - 0.1 - 0.005)
    assert 0.0 < example.main(decisions=20) < 0.3


@of("own_data")
def test_logs_are_written_read_and_learnt_from(example: ModuleType, tmp_path: Path) -> None:
    errors = example.main(str(tmp_path), episodes=2, steps=20, epochs=8)
    assert errors[-1] < errors[0]
    with EpisodeReader(tmp_path / "001.mcap") as log:
        assert log.info.operator == "mine"


@of("own_xray_pair")
def test_a_drawn_pair_is_read_in_space(example: ModuleType) -> None:
    error_mm = example.main()
    assert error_mm < 1.0


@of("sweep")
def test_every_combination_is_run(example: ModuleType) -> None:
    results = example.main(wires=("default",), catheters=(None,), targets=("bca", "lcca"), steps=2)
    assert list(results) == [("default", None, "bca"), ("default", None, "lcca")]
    assert all(steps == 2 and not reached for reached, steps, _ in results.values())


@of("shown_by_policies")
def test_a_policy_learns_from_what_others_show(example: ModuleType, tmp_path: Path) -> None:
    cases = example.steep_cases(2000, 1)
    assert [(kind, seed) for kind, seed, _ in cases] == [("II", 2000)] * 2
    env = example.training_env(cases, 5)
    assert [env.reset(options={"case": case})[1]["case"] for case in range(2)] == [0, 1]
    assert env.task.target == cases[1][2]
    result = example.main(arches=1, decisions=64, draws=1, steps=5, folder=str(tmp_path))
    assert result.timings["decisions"] == 64
    assert result.policy.action_space.shape == (4,)
    assert result.policy.action_repeat == example.HOLD
    assert result.policy.metadata["task"]["pace"] == "arch_variety"
    assert (tmp_path / "policy.pt").is_file()


@of("shown_by_policies")
def test_a_policy_of_arches_learns_trees(example: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert example.tree_seeds(2000, 1, bovine=True) != example.tree_seeds(2000, 1, bovine=False)
    cases = example.tree_cases([2000], (example.LEFT, example.VERTEBRAL))
    env = example.training_env(cases, 5)
    assert env.reset(options={"case": 1})[1]["phantom"] == "random_tree_2000"
    assert env.phantom.target(env.task.target).branch.startswith("vertebral")
    assert env.simulation.pair.catheter.length == 1.05
    # episodes are short, and there is one tree: a tree takes seconds
    env_of = example.training_env
    monkeypatch.setattr(example, "tree_seeds", lambda first, trees, bovine: [2000] * trees)
    monkeypatch.setattr(example, "TRAVEL", 5)
    monkeypatch.setattr(example, "training_env", lambda cases, steps, **more: env_of(cases, min(steps, 20), **more))
    result = example.trees(trees=1, decisions=32, steps=55, folder=str(tmp_path))
    assert result.timings["decisions"] == 32
    assert result.policy.critics
    assert result.policy.action_repeat == example.HOLD


@of("her")
def test_goals_are_relabelled_and_the_example_runs(example: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    models: list[SAC] = []

    def early(*arguments: Any, **named: Any) -> SAC:
        models.append(SAC(*arguments, **named | {"learning_starts": 45}))
        return models[-1]

    usual = example.make_env
    monkeypatch.setattr(example, "make_env", lambda: gymnasium.wrappers.TimeLimit(usual(), 20))
    monkeypatch.setattr(example, "SAC", early)
    monkeypatch.setattr(example, "HELD_OUT", range(10_000, 10_001))
    assert {*example.main(60, seed=0)} <= {0, 1}
    assert isinstance(models[0].replay_buffer, HerReplayBuffer)
    sample = models[0].replay_buffer.sample(200)
    goals = sample.observations["desired_goal"].numpy()
    reached = sample.next_observations["achieved_goal"].numpy()
    rewards = sample.rewards.numpy().ravel()
    near = np.linalg.norm(goals - reached, axis=1) <= 0.008
    assert np.array_equal(rewards, np.where(near, 0.0, -1.0))
    assert (rewards == 0.0).sum() > 20, "only relabelled goals are reached that early"
