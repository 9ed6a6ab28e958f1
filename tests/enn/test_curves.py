"""Curves for a logger: names, steps and values as given, and added to after an interruption."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from enn.curves import CHOICE, Curves, open_writer
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


class RecordedCalls:
    """Stands in for the module wandb: keeps what it is told."""

    def __init__(self) -> None:
        self.runs: list[dict[str, Any]] = []
        self.told: list[Any] = []

    def Settings(self, **values: Any) -> dict[str, Any]:
        return values

    def init(self, **arguments: Any) -> SimpleNamespace:
        self.runs.append(arguments)
        return SimpleNamespace(
            define_metric=lambda *names, step_metric: None,
            log=self.told.append,
            finish=lambda: self.told.append("finish"),
        )


def test_a_training_is_one_run_at_weights_and_biases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wandb = RecordedCalls()
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    monkeypatch.setenv(CHOICE, "wandb")
    for step in (1, 2):  # interrupted after the first
        with Curves(tmp_path / "a") as curves:
            curves.add(step, loss=0.5, validation=None)
    with Curves(tmp_path / "b") as curves:
        curves.add(1, loss=0.25)
    first, again, other = wandb.runs
    assert first["id"] == again["id"] != other["id"]
    assert (first["project"], first["resume"], first["dir"]) == ("endonav", "allow", str(tmp_path / "a"))
    assert wandb.told == [
        {"train/loss": 0.5, "at": 1}, "finish", {"train/loss": 0.5, "at": 2}, "finish", {"train/loss": 0.25, "at": 1},
        "finish",
    ]  # fmt: skip


def test_weights_and_biases_itself_keeps_them_without_a_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    writer: Any = open_writer(tmp_path, "wandb")
    for step in (7, 3):  # steps of another curve may go back
        writer.add_scalar("train/loss", 1 / step, step)
    kept = writer._run.summary
    assert (kept["train/loss"], kept["at"]) == (pytest.approx(1 / 3), 3)
    writer.close()
    [file] = (tmp_path / "wandb").glob("offline-run-*/run-*.wandb")
    assert file.stat().st_size > 1000


def test_no_logger_writes_nothing_and_an_unknown_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Curves(tmp_path, "none") as curves:
        curves.add(1, loss=0.5)
    with Curves(tmp_path):
        pass  # nothing is measured
    assert not list(tmp_path.iterdir())
    monkeypatch.setenv(CHOICE, "mlflow")
    with pytest.raises(ValueError, match="no logger 'mlflow'"):
        Curves(tmp_path)
