"""Curves for TensorBoard: names, steps and values as given, and added to after an interruption."""

from __future__ import annotations

from pathlib import Path

from enn.reinforcement.training.result import Progress
from pipeline.recording.curves import Curves
from pipeline.stages.learning.training import words
from tests.pipeline.event_scalars import scalars


def test_scalars_keep_name_step_and_value_and_go_on(tmp_path: Path) -> None:
    with Curves(tmp_path) as curves:
        curves.add(1, loss=0.5, validation=None)
        curves.add(2, "rounds", success=0.25)
    with Curves(tmp_path) as curves:
        curves.add_epochs([{"epoch": 2, "loss": 0.25, "validation": 0.75, "cpu_s": 1.0}])
    assert scalars(tmp_path) == {
        "train/loss": {1: 0.5, 2: 0.25}, "train/validation": {2: 0.75}, "rounds/success": {2: 0.25},
    }  # fmt: skip


def test_nothing_is_written_where_nothing_is_measured(tmp_path: Path) -> None:
    with Curves(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_the_return_stands_beside_the_bar() -> None:
    assert words(Progress(10, 100, 0.5, -12.34, 0.75, 1.0, 9.0)) == "return -12.3, success 50 %, best 75 %"
    assert words(Progress(10, 100, None, None, None, 1.0, 9.0)) == ""
