"""Reinforcement learning: it learns, reports its curve, and keeps to its settings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.policy import Policy
from enn.reinforcement.evaluation import run_episodes
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training import (
    DESK_PPO,
    DESK_SAC,
    THESIS_SAC,
    PpoSettings,
    Progress,
    SacSettings,
    Training,
    TrainingSettings,
)
from enn.reinforcement.training.result import COLUMNS, TrainingLog
from enn.reinforcement.training.training import TrainingRun
from tests.enn.reinforcement.small_training import SMALL


def test_sac_learns_and_its_curve_and_files_say_so(point_env: Any, tmp_path: Path) -> None:
    seen: list[Progress] = []
    settings = dataclasses.replace(SMALL, gradient_steps=1.0)
    result = Training(settings, point_env, tmp_path, seed=3, metadata={"target": "centre"}).run(seen.append)
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12
    lines = (tmp_path / "training.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) == 1 + len(result.curve) == 10
    assert [row["decisions"] for row in result.curve] == [104, 200, 304, 400, 504, 600, 704, 800, 904]
    assert result.curve[-1]["reward"] > result.curve[0]["reward"]
    assert result.curve[2]["evaluation_success"] is not None
    assert result.curve[3]["evaluation_success"] is None
    record = json.loads((tmp_path / "training.json").read_text())
    assert record["settings"]["hidden"] == [32, 32]
    assert record["metadata"] == {"seed": 3, "target": "centre", "decisions": 904}
    assert seen[0].decisions == 0
    assert seen[-1].total == 900
    assert result.timings["updates"] == pytest.approx(704, abs=8)
    assert not (tmp_path / "tensorboard").exists()
    loaded = Policy.load(tmp_path / "policy.pt")
    played = run_episodes(loaded, [point_env()], [7, 8, 9], deterministic=True)
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
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12


def test_the_same_seed_gives_the_same_training(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, decisions=320, evaluate_every=160)
    weights = []
    for seed in (2, 2, 3):
        policy = Training(settings, point_env, None, seed=seed).run().policy
        weights.append(torch.cat([value.flatten() for value in policy.module.actor.parameters()]))
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_updates_beside_the_simulation_learn_and_do_not_depend_on_threads_and_processes(
    point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = dataclasses.replace(SMALL, gradient_steps=1.0, overlap=True)
    weights = []
    for threads, worth in ((1, 0), (3, 0), (3, 10_000)):
        monkeypatch.setattr("enn.reinforcement.training.inputs.WORTH_A_PROCESS", worth)
        result = Training(dataclasses.replace(settings, threads=threads), point_env, None, seed=3).run()
        assert result.evaluation is not None
        assert result.evaluation["success"] == 1.0
        assert result.timings["updates"] == pytest.approx(696, abs=8)
        weights.append(torch.cat([value.flatten() for value in result.policy.module.actor.parameters()]))
    assert all(torch.equal(weights[0], others) for others in weights[1:])


def test_action_repeat_counts_steps_and_is_played_in_evaluation(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, action_repeat=2, decisions=400, evaluate_every=400)
    result = Training(settings, point_env, None, seed=0).run()
    assert result.policy.action_repeat == 2
    assert 1.5 * 400 < result.timings["env_steps"] <= 800


def test_event_files_on_request(point_env: Any, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    settings = dataclasses.replace(SMALL, decisions=240, evaluate_every=0, tensorboard=True)
    Training(settings, point_env, tmp_path).run()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("curve/reward")] == [104, 200, 240]
    assert events.Scalars("curve/episode_return")[-1].step == 240
    assert "train/critic_loss" in events.Tags()["scalars"]


def test_returns_are_those_of_all_episodes_and_success_of_those_from_the_start() -> None:
    log = TrainingLog(None, lambda: 0.0)
    assert log.episode_return() is None
    ended = [{"r": 3.0, "l": 2, "success": True, "fresh": False}, {"r": -1.0, "l": 4, "success": False, "fresh": True}]
    log.observe([1.0, 2.0], [{"steps": 1, "episode": episode} for episode in ended])
    assert (log.episode_return(), log.success()) == (1.0, 0.0)
    twin = TrainingLog(None, lambda: 0.0)
    twin.restore(log.state())
    assert twin.episode_return() == 1.0


def test_the_thesis_preset_learns_its_entropy(point_env: Any) -> None:
    settings = dataclasses.replace(
        THESIS_SAC,
        extractor="vectors",
        variant="desk",
        hidden=(32, 32),
        decisions=1500,
        learning_rate=3e-3,
        batch_size=64,
        buffer_size=1500,
        evaluate_every=0,
    )
    run = TrainingRun(Training(settings, point_env, seed=0), None)
    weights, entropies = [], []
    try:
        while not run._pause():
            run._decide()
            scalars = run.learner.scalars()
            weights.append(scalars.get("train/ent_coef", 1.0))
            entropies.append(scalars.get("train/entropy", 0.0))
        target = float(run.learner.model.target_entropy)
    finally:
        run.close()
    assert target == -2.0
    assert weights[101] > 0.98
    assert weights[-1] < 0.3
    early, late = (abs(float(np.mean(part)) - target) for part in (entropies[150:350], entropies[-200:]))
    assert late < 0.5 < 2.0 < early, "the entropy must have come close to its target"


@pytest.mark.parametrize("preset", [THESIS_SAC, DESK_SAC])
def test_entropy_of_each_number_of_actions(preset: TrainingSettings, point_env: Any) -> None:
    class Motors(point_env):  # type: ignore[misc]
        action_space = gymnasium.spaces.Box(-1, 1, (21,), np.float32)

    small = {"extractor": "vectors", "variant": "desk", "hidden": (8,), "buffer_size": 64, "reset_bank_share": 0.0}
    run = TrainingRun(Training(dataclasses.replace(preset, **small), Motors, seed=0), None)
    assert run.learner.model.target_entropy == -21.0
    assert run.learner.model.ent_coef_optimizer is not None
    run.close()


def test_refusals_say_why() -> None:
    with pytest.raises(ValueError, match="decisions must be greater than or equal to 1, got 0"):
        SacSettings(decisions=0)
    with pytest.raises(ValueError, match=r"ent_coef must be a valid number.*, got 'auto_0\.05'"):
        PpoSettings(ent_coef="auto_0.05")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="TrainingSettings name no algorithm: take SacSettings or PpoSettings"):
        TrainingSettings()
    with pytest.raises(ValueError, match="with cloning_weight give demonstrations_in_replay, too"):
        SacSettings(cloning_weight=1.0)
    with pytest.raises(ValueError, match="algorithm must be 'sac', got 'ppo'"):
        SacSettings(algorithm="ppo")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="gamma must be less than or equal to 1, got"):
        SacSettings(gamma=1.5)


@pytest.mark.parametrize("preset", [SMALL, dataclasses.replace(DESK_PPO, n_steps=16, batch_size=32, action_repeat=1)])
def test_learning_rate_falls_evenly_to_its_share(point_env: Any, preset: TrainingSettings) -> None:
    settings = dataclasses.replace(
        preset, decisions=400, learning_starts=0, final_learning_rate=0.1, evaluate_every=0, curve_every=100
    )
    training = Training(settings, point_env, seed=0)
    run = TrainingRun(training, None)
    rates = []
    try:
        while not run._pause():
            run._decide()
            rates.append(optimizer_of(run).param_groups[0]["lr"])
    finally:
        run.close()
    assert rates[0] > 0.9 * settings.learning_rate
    assert rates[-1] == pytest.approx(0.1 * settings.learning_rate, rel=0.5)
    assert np.all(np.diff(rates) <= 0)


def optimizer_of(run: TrainingRun) -> Any:
    model = run.learner.model
    return model.critic.optimizer if isinstance(run.learner, SacLearner) else model.policy.optimizer


def test_starts_enter_the_bank_and_validation_has_its_own_environments(point_env: Any) -> None:
    made: list[str] = []

    def named(name: str) -> Any:
        def make() -> Any:
            made.append(name)
            return point_env()

        return make

    starts = [np.full((4, 2), 0.5), np.full((2, 2), -0.5)]
    settings = dataclasses.replace(SMALL, decisions=400, evaluate_every=400, n_envs=2, reset_bank_share=0.5)
    training = Training(settings, named("training"), seed=0, starts=starts, make_validation_env=named("validation"))
    run = TrainingRun(training, None)
    assert run.sampled.reset_bank is not None
    assert len(run.sampled.reset_bank) == 6
    run.close()
    made.clear()
    training.run()
    assert made == ["training", "training", "validation", "validation"]
