"""Trials: one log a held-out seed, with what tables group by, and none repeated after an interruption."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.recording.trials import Origin, run_trials, summary
from pipeline.seeds import held_out_seeds
from pipeline.stages.learning.task import LearningTask
from pipeline.task import Task

TASK = LearningTask("type_1", "bca", Task(max_steps=6))
ORIGIN = Origin("enn", "I+V+M", 3, "desk", {"training_force_penalty": 0.5})


class Draws:
    """A policy of random actions that counts the episodes it was made for."""

    def __init__(self) -> None:
        self.seeds: list[int] = []

    def __call__(self, seed: int):
        self.seeds.append(seed)
        generator = np.random.default_rng(seed)
        return lambda observation, info: generator.uniform(0, 1, 2).astype(np.float32)


def trials(folder: Path, draws: Draws, *, count: int = 3, **further):
    environment = TASK.environment("tip")
    return run_trials(
        environment, draws, folder, seeds=held_out_seeds(3, count), mode="stochastic", origin=ORIGIN, **further
    )


def test_each_seed_has_a_log_that_says_where_it_comes_from(tmp_path: Path) -> None:
    told: list[tuple[float, str]] = []
    metrics = trials(tmp_path, Draws(), report=lambda fraction, text: told.append((fraction, text)))
    assert told == [(1 / 3, "0/1"), (2 / 3, "0/2"), (1.0, "0/3")]
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["000.mcap", "001.mcap", "002.mcap"]
    with EpisodeReader(tmp_path / "001.mcap") as log:
        assert log.info.seed == held_out_seeds(3, 3)[1]
        said = {key: log.info.configuration[key] for key in ("stage", "row", "mode", "training_seed", "variant")}
        assert said == {"stage": "enn", "row": "I+V+M", "mode": "stochastic", "training_seed": 3, "variant": "desk"}
        assert log.info.configuration["training_force_penalty"] == 0.5
        assert log.info.configuration["start_rotation"] == pytest.approx(np.pi)
        arrays = log.load_arrays()
        assert not [name for name in arrays if name.startswith("image")]
        # the thesis's reward, whatever the training's was
        np.testing.assert_allclose(arrays["reward"][1:], -arrays["extra/distance_m"][1:])
        assert metrics[1].force_max == arrays["resultant_force_norm"][1:].max()


def test_a_recorded_episode_is_not_repeated_and_an_unfinished_one_is(tmp_path: Path) -> None:
    whole, resumed = trials(tmp_path / "whole", Draws()), Draws()
    trials(tmp_path / "half", Draws(), count=2)
    (tmp_path / "half" / "001.mcap").write_bytes(b"torn")
    (tmp_path / "half" / "002.mcap.partial").write_bytes(b"killed")
    assert trials(tmp_path / "half", resumed) == whole
    assert resumed.seeds == [held_out_seeds(3, 3)[1], held_out_seeds(3, 3)[2]]
    assert not list((tmp_path / "half").glob("*.partial"))


def test_pictures_on_request(tmp_path: Path) -> None:
    trials(tmp_path, Draws(), count=1, pictures=True)
    with EpisodeReader(tmp_path / "000.mcap") as log:
        assert log.load_arrays()["image/frontal"].shape == (7, 80, 80)


def test_summary_and_refusals(tmp_path: Path) -> None:
    row = summary(trials(tmp_path, Draws()))
    assert row["n"] == 3
    assert row["episode_length_steps"] == 6
    assert row["success_pct"] == 0
    with pytest.raises(ValueError, match="unknown mode 'best'; there are deterministic, stochastic"):
        run_trials(TASK.environment("tip"), Draws(), tmp_path, seeds=[0], mode="best", origin=ORIGIN)
