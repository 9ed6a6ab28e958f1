"""Curves for TensorBoard: names, steps and values as given, and added to after an interruption."""

from __future__ import annotations

from pathlib import Path

from enn.curves import Curves
from tests.enn.event_scalars import scalars


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
