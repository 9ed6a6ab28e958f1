"""Trainings learn, repeat, resume, start from a policy, see what they may, and follow the thesis's presets."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError
from enn.reinforcement.evaluation import run_episodes
from enn.reinforcement.replay import demonstration_replay
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training.result import COLUMNS, Progress, TrainingResult
from enn.reinforcement.training.settings import (
    DESK_PPO,
    THESIS_PPO,
    THESIS_SAC,
    PpoSettings,
    SacSettings,
    TrainingSettings,
)
from enn.reinforcement.training.training import Training, TrainingRun
from enn.reinforcement.vector_envs import SampledEnvs
from tests.enn.conftest import PointEnv
from tests.enn.event_scalars import scalars
from tests.enn.reinforcement.small_training import SMALL, demonstrated, interrupted, require_same_weights


@pytest.fixture(scope="module")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TrainingResult, list[Progress]]:
    """The folder of a training that learns, its result, and what it told meanwhile."""
    folder, seen = tmp_path_factory.mktemp("learnt"), []
    settings = dataclasses.replace(SMALL, gradient_steps=1.0, keep_critics=True)
    training = Training(settings, PointEnv, folder, seed=3, metadata={"target": "centre"})
    return folder, training.run(seen.append), seen


def test_sac_learns_and_its_curve_and_files_say_so(learnt: tuple[Path, TrainingResult, list[Progress]]) -> None:
    folder, result, seen = learnt
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12
    lines = (folder / "training.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) == 1 + len(result.curve) == 10
    assert [row["decisions"] for row in result.curve] == [104, 200, 304, 400, 504, 600, 704, 800, 904]
    assert result.curve[-1]["reward"] > result.curve[0]["reward"]
    assert result.curve[2]["evaluation_success"] is not None
    assert result.curve[3]["evaluation_success"] is None
    record = json.loads((folder / "training.json").read_text())
    assert record["settings"]["hidden"] == [32, 32]
    assert 0 < record["metadata"].pop("entropy_weight") < 1  # kept with the critics
    assert record["metadata"] == {"seed": 3, "target": "centre", "decisions": 904}
    assert seen[0].decisions == 0
    assert seen[-1].total == 900
    assert result.timings["updates"] == pytest.approx(704, abs=8)
    assert not (folder / "tensorboard").exists()
    played = run_episodes(Policy.load(folder / "policy.pt"), [PointEnv()], [7, 8, 9], deterministic=True)
    assert played.success == 1.0


def test_ppo_learns(point_env: Any) -> None:
    settings = dataclasses.replace(
        DESK_PPO,
        action_repeat=1,
        decisions=6000,
        hidden=(32, 32),
        learning_starts=200,
        n_steps=64,
        epochs=10,
        learning_rate=3e-3,
        evaluate_every=3000,
        evaluation_episodes=5,
        stop_after=0,
    )
    result = Training(settings, point_env, None, seed=0).run()
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12


def test_updates_beside_the_simulation_learn_and_do_not_depend_on_threads_and_processes(
    point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = dataclasses.replace(SMALL, gradient_steps=1.0, overlap=True)
    learnt = Training(dataclasses.replace(settings, threads=3), point_env, None, seed=3).run()
    assert learnt.evaluation["success"] == 1.0
    assert learnt.timings["updates"] == pytest.approx(696, abs=8)
    weights = []
    short = dataclasses.replace(settings, decisions=240, evaluate_every=0)
    for threads, worth in ((1, 0), (3, 0), (3, 10_000)):
        monkeypatch.setattr("enn.reinforcement.training.inputs.WORTH_A_PROCESS", worth)
        result = Training(dataclasses.replace(short, threads=threads), point_env, None, seed=3).run()
        weights.append(torch.cat([value.flatten() for value in result.policy.module.actor.parameters()]))
    assert all(torch.equal(weights[0], others) for others in weights[1:])


def test_event_files_on_request(point_env: Any, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    settings = dataclasses.replace(SMALL, decisions=240, evaluate_every=0, logger="tensorboard")
    Training(settings, point_env, tmp_path).run()
    found = scalars(tmp_path)
    assert list(found["curve/reward"]) == [104, 200, 240]
    assert max(found["curve/episode_return"]) == 240
    assert "train/critic_loss" in found


def test_the_seed_decides_and_what_is_called_after_evaluations_sees_them_and_changes_nothing(point_env: Any) -> None:
    settings, seen = dataclasses.replace(SMALL, decisions=240, evaluate_every=100), []

    def film(policy: Policy, decisions: int) -> None:
        seen.append((decisions, policy.keys))

    filmed = Training(settings, point_env, after_evaluation=film).run()
    plain, other = (Training(settings, point_env, seed=seed).run() for seed in (0, 3))
    assert [decisions for decisions, _ in seen] == [104, 200, 240]
    clocks = {"wall_s": 0.0, "cpu_s": 0.0}
    assert [row | clocks for row in filmed.curve] == [row | clocks for row in plain.curve]
    require_same_weights(filmed.policy, plain.policy)
    with pytest.raises(AssertionError):
        require_same_weights(plain.policy, other.policy)


def test_starts_enter_the_buffer_and_validation_has_its_own_environments(point_env: Any) -> None:
    made: list[str] = []

    def named(name: str) -> Any:
        def make() -> Any:
            made.append(name)
            return point_env()

        return make

    starts = [np.full((4, 2), 0.5), np.full((2, 2), -0.5)]
    settings = dataclasses.replace(SMALL, decisions=400, evaluate_every=400, n_envs=2, start_state_buffer_share=0.5)
    training = Training(settings, named("training"), seed=0, starts=starts, make_validation_env=named("validation"))
    run = TrainingRun(training, None)
    assert len(run.sampled.start_state_buffer) == 6
    run.close()
    made.clear()
    training.run()
    assert made == ["training", "training", "validation", "validation"]


def test_the_thesis_presets_are_its_tables() -> None:
    table = {
        "learning_rate": 3e-4,
        "buffer_size": 1_000_000,
        "batch_size": 256,
        "tau": 0.005,
        "gamma": 0.99,
        "gradient_steps": 1,
        "ent_coef": "auto_1.0",  # its 1, where the learning starts
        "target_entropy": None,  # its -2, for two actions
    }
    assert {name: getattr(THESIS_SAC, name) for name in table} == table
    assert THESIS_SAC.decisions == THESIS_PPO.decisions == 600_000
    assert THESIS_PPO.learning_rate == 3e-4
    assert THESIS_PPO.variant == THESIS_SAC.variant == "thesis"


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match=r"ent_coef must be a valid number.*, got 'auto_0\.05'"):
        PpoSettings(ent_coef="auto_0.05")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="take SacSettings or PpoSettings"):
        TrainingSettings()
    with pytest.raises(ValueError, match="with cloning_weight give demonstrations_in_replay"):
        SacSettings(cloning_weight=1.0)
    with pytest.raises(ValueError, match="algorithm must be 'sac', got 'ppo'"):
        SacSettings(algorithm="ppo")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"a fixed ent_coef of 1\.0 aims at no entropy"):
        dataclasses.replace(THESIS_SAC, ent_coef=1.0, target_entropy=-2.0)
    for odd in ("auto_0", "auto_x", "fixed", "auto_nan"):
        with pytest.raises(ValueError, match="ent_coef must be a number, auto, or auto_ and the positive number"):
            dataclasses.replace(THESIS_SAC, ent_coef=odd)
    with pytest.raises(ValueError, match="SacSettings has no n_steps"):
        dataclasses.replace(THESIS_SAC, n_steps=128)
    for name, value in {"target_entropy": -2.0, "buffer_size": 9, "tau": 0.5, "gradient_steps": 2.0}.items():
        with pytest.raises(ValueError, match=f"PpoSettings has no {name}"):
            dataclasses.replace(THESIS_PPO, **{name: value})


def test_a_smaller_budget_makes_smaller_what_has_no_room_in_it() -> None:
    small = THESIS_SAC.sized(48, 2, logger="wandb")
    assert (small.decisions, small.buffer_size, small.learning_starts, small.logger) == (48, 48, 12, "wandb")
    assert (small.evaluate_every, small.evaluation_episodes, small.curve_every) == (48, 2, 48)
    assert THESIS_PPO.sized(1024, 30).n_steps == 512
    assert THESIS_PPO.sized(1, 30).n_steps == 16
    assert THESIS_SAC.sized(THESIS_SAC.decisions, 30) == dataclasses.replace(THESIS_SAC, buffer_size=600_000)


def test_demonstrations_enter_buffer_and_replay(point_env: Any) -> None:
    trajectories = demonstrated(point_env)
    settings = dataclasses.replace(
        SMALL, decisions=240, demonstrations_in_replay=0.25, evaluate_every=0, start_state_buffer_share=1.0
    )
    run = TrainingRun(Training(settings, point_env, None, 0, trajectories), None)
    assert isinstance(run.learner, SacLearner)
    assert run.learner.replay.demonstrations.added == sum(map(len, trajectories))
    assert isinstance(run.sampled, SampledEnvs)
    assert len(run.sampled.start_state_buffer) >= 3
    drawn = run.learner.replay.demonstrations.gather(
        np.arange(len(trajectories[0])), np.zeros(len(trajectories[0]), int)
    )
    np.testing.assert_allclose(drawn.actions, trajectories[0].actions, atol=1e-6)
    np.testing.assert_allclose(drawn.next_observations["place"], trajectories[0].observations["place"][1:])
    assert drawn.dones[-1] == 1.0
    starts = run.envs.reset()["place"]
    known = np.concatenate([t.observations["place"] for t in trajectories])
    assert all(np.abs(known - start).max(axis=1).min() < 1e-6 for start in starts)
    result = run.train()
    assert result.evaluation is None

    held = demonstration_replay(
        trajectories[:1], run.envs.observation_space, point_env.action_space, action_repeat=len(trajectories[0])
    )
    assert held.added == 1
    whole = held.gather(np.zeros(1, int), np.zeros(1, int))
    np.testing.assert_allclose(whole.actions[0], trajectories[0].actions.mean(axis=0), atol=1e-6)
    assert float(whole.rewards) == pytest.approx(trajectories[0].rewards.sum(), rel=1e-5)
    np.testing.assert_allclose(whole.next_observations["place"][0], trajectories[0].observations["place"][-1])
    with pytest.raises(ValueError, match="no demonstrations to put"):
        demonstration_replay([], run.envs.observation_space, point_env.action_space)


def test_the_real_simulator_trains_a_little(tmp_path: Path) -> None:
    pytest.importorskip("cathsim")

    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make(
            "cathsim:cathsim/Navigate-v0",
            observation=("shape", "feeder"),
            reward="geodesic",
            success_radius=0.008,
            max_steps=20,
            start_jitter=0.001,
            start_rotation=np.pi,
            disable_env_checker=True,
        )

    settings = dataclasses.replace(
        SMALL,
        decisions=120,
        n_envs=2,
        learning_starts=60,
        evaluate_every=120,
        evaluation_episodes=2,
        gradient_steps=0.2,
    )
    result = Training(settings, make, None, seed=0).run()
    assert result.evaluation["steps"] == 20
    interrupted(Training(settings, make, tmp_path, seed=0), 80)
    resumed = Training(settings, make, tmp_path, seed=0).run()
    assert resumed.evaluation == result.evaluation
    require_same_weights(result.policy, resumed.policy)
    assert result.evaluation["path_mm"] > 0
    assert Policy.load(tmp_path / "policy.pt").keys == ("feeder", "shape")


def test_with_a_frozen_encoder_it_trains_resumes_and_loads(point_env: Any, tmp_path: Path) -> None:
    def make() -> Any:
        return point_env(("place", "mask"), max_steps=15)

    torch.manual_seed(0)
    encoder = Encoder(EncoderSettings(keys=("mask",), shapes=((1, 36, 36),), channels=(4,), hidden=16, features=8))
    before = {name: value.clone() for name, value in encoder.state_dict().items()}
    settings = dataclasses.replace(SMALL, decisions=240, learning_starts=80, evaluate_every=120, evaluation_episodes=3)
    straight = Training(settings, make, None, seed=0, encoder=encoder).run()
    interrupted(Training(settings, make, tmp_path, seed=0, encoder=encoder), 120)
    resumed = Training(settings, make, tmp_path, seed=0, encoder=encoder).run()
    batch = {"mask": np.zeros((4, 1, 36, 36), np.uint8)}
    batch["mask"][np.arange(4), 0, np.arange(4), 5] = 255
    loaded = Policy.load(tmp_path / "policy.pt")
    assert loaded.keys == ("mask",)
    assert loaded.features(batch).shape == (4, 8)
    np.testing.assert_array_equal(straight.policy.act_batch(batch), resumed.policy.act_batch(batch))
    np.testing.assert_array_equal(loaded.act_batch(batch), resumed.policy.act_batch(batch))
    assert all(torch.equal(value, before[name]) for name, value in encoder.state_dict().items())


SHORT = dataclasses.replace(
    SMALL, stop_after=0, decisions=240, learning_starts=80, evaluate_every=120, keep_critics=True
)


@pytest.fixture
def trained(learnt: tuple[Path, TrainingResult, list[Progress]]) -> Path:
    return learnt[0] / "policy.pt"


def test_the_critics_are_kept_and_read(trained: Path, tmp_path: Path) -> None:
    policy = Policy.load(trained)
    assert policy.critics
    policy.save(tmp_path / "acting.pt")
    acting = Policy.load(tmp_path / "acting.pt")
    assert not acting.critics
    observation = {"place": np.array([0.3, -0.2], np.float32)}
    np.testing.assert_array_equal(acting.act(observation), policy.act(observation))
    assert (tmp_path / "acting.pt").stat().st_size < 0.5 * trained.stat().st_size
    with pytest.raises(ValueError, match="this policy has no critics"):
        acting.save(tmp_path / "again.pt", critics=True)
    with pytest.raises(ValueError, match="has no critics"):
        Training(SHORT, PointEnv, initial=acting).run()


def test_it_begins_with_the_policys_weights_and_keeps_them_if_none_are_better(trained: Path, point_env: Any) -> None:
    initial = Policy.load(trained)
    settings = dataclasses.replace(SHORT, decisions=200, learning_starts=200, evaluate_every=200)
    result = Training(settings, point_env, seed=5, initial=initial).run()
    require_same_weights(initial, result.policy)
    assert result.timings["updates"] == 0
    # it acts itself from the first decision on: nearly every training episode succeeds
    assert result.curve[-1]["success"] > 0.8


def test_an_interrupted_one_goes_on_exactly(trained: Path, point_env: Any, tmp_path: Path) -> None:
    initial = Policy.load(trained)
    whole = Training(SHORT, point_env, tmp_path / "whole", seed=5, initial=initial).run()
    settings = dataclasses.replace(SHORT, checkpoint_seconds=0.0)
    interrupted(Training(settings, point_env, tmp_path / "parts", seed=5, initial=initial), 160)
    other = Policy.load(trained)
    next(other.module.parameters()).data.add_(1e-3)
    with pytest.raises(CheckpointError, match="its initial is"):
        Training(settings, point_env, tmp_path / "parts", seed=5, initial=other).run()
    parts = Training(settings, point_env, tmp_path / "parts", seed=5, initial=initial).run()
    require_same_weights(whole.policy, parts.policy)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"hidden": (16, 16)}, r"hidden=\(32, 32\), not \(16, 16\)"),
        ({"action_repeat": 2}, "holds actions for 1 steps, the training for 2"),
    ],
)
def test_another_network_is_refused(trained: Path, point_env: Any, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Training(dataclasses.replace(SHORT, **changed), point_env, initial=Policy.load(trained)).run()
