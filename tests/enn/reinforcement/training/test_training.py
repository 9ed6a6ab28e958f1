"""Trainings learn, repeat, say so in files, and follow the thesis's presets."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.policy import Policy
from enn.reinforcement.evaluation import run_episodes
from enn.reinforcement.training import (
    DESK_PPO,
    THESIS_PPO,
    THESIS_SAC,
    PpoSettings,
    Progress,
    SacSettings,
    Training,
    TrainingSettings,
)
from enn.reinforcement.training.result import COLUMNS
from enn.reinforcement.training.training import TrainingRun
from tests.enn.reinforcement.small_training import SMALL


def test_sac_learns_and_its_curve_and_files_say_so(point_env: Any, tmp_path: Path) -> None:
    seen: list[Progress] = []
    settings = dataclasses.replace(SMALL, gradient_steps=1.0)
    result = Training(settings, point_env, tmp_path, seed=3, metadata={"target": "centre"}).run(seen.append)
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
    learnt = Training(dataclasses.replace(settings, threads=3), point_env, None, seed=3).run()
    assert learnt.evaluation["success"] == 1.0
    assert learnt.timings["updates"] == pytest.approx(696, abs=8)
    weights = []
    short = dataclasses.replace(settings, decisions=320, evaluate_every=0)
    for threads, worth in ((1, 0), (3, 0), (3, 10_000)):
        monkeypatch.setattr("enn.reinforcement.training.inputs.WORTH_A_PROCESS", worth)
        result = Training(dataclasses.replace(short, threads=threads), point_env, None, seed=3).run()
        weights.append(torch.cat([value.flatten() for value in result.policy.module.actor.parameters()]))
    assert all(torch.equal(weights[0], others) for others in weights[1:])


def test_event_files_on_request(point_env: Any, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    settings = dataclasses.replace(SMALL, decisions=240, evaluate_every=0, logger="tensorboard")
    Training(settings, point_env, tmp_path).run()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("curve/reward")] == [104, 200, 240]
    assert events.Scalars("curve/episode_return")[-1].step == 240
    assert "train/critic_loss" in events.Tags()["scalars"]


def test_what_is_called_after_evaluations_sees_them_and_changes_nothing(point_env: Any) -> None:
    settings, seen = dataclasses.replace(SMALL, decisions=240, evaluate_every=100), []

    def film(policy: Policy, decisions: int) -> None:
        seen.append((decisions, policy.keys))

    curves = [Training(settings, point_env, after_evaluation=each).run().curve for each in (film, None)]
    assert [decisions for decisions, _ in seen] == [104, 200, 240]
    same = [
        [{name: value for name, value in row.items() if name not in ("wall_s", "cpu_s")} for row in c] for c in curves
    ]
    assert same[0] == same[1]


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
    assert len(run.sampled.reset_bank) == 6
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
    with pytest.raises(ValueError, match=r"a fixed ent_coef of 1\.0 aims at no entropy"):
        dataclasses.replace(THESIS_SAC, ent_coef=1.0, target_entropy=-2.0)
    for odd in ("auto_0", "auto_-1", "auto_x", "fixed", "auto_nan"):
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
