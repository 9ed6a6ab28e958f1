"""Training: it learns, stops and resumes exactly, also after kill -9, and refuses checkpoints of something else."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.model_file import read_content
from guide3d.learning.training import BEST, LAST, NetworkFitSettings, TrainingError, finished, fit

SETTINGS = NetworkFitSettings(epochs=6, batch_size=8, learning_rate=0.05, schedule="constant", patience=0)


class Line:
    """y = 3 x with noise drawn anew each time."""

    def __init__(self, count: int = 32) -> None:
        self.training_items, self.validation_items = np.arange(count), np.arange(count, count + 8)
        self.x = torch.linspace(-1, 1, count + 8)

    def batch(self, items, generator):
        x = self.x[torch.from_numpy(items)]
        noise = 0.0 if generator is None else torch.from_numpy(generator.normal(0, 0.1, len(items))).float()
        return {"x": x[:, None], "y": (3 * x + noise)[:, None]}

    def loss(self, module, batch):
        return (module(batch["x"]) - batch["y"]).square().mean()


def network() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(1, 8), torch.nn.Dropout(0.2), torch.nn.Linear(8, 1))


@pytest.mark.parametrize(
    ("optimiser", "schedule"),
    [("nadam", "plateau"), ("adamw", "one_cycle"), ("sgd", "polynomial"), ("nadam", "constant")],
)
def test_it_learns(tmp_path: Path, optimiser: str, schedule: str) -> None:
    settings = dataclasses.replace(SETTINGS, epochs=20, optimiser=optimiser, schedule=schedule)
    report = fit(network(), Line(), settings, folder=tmp_path)
    assert report.rows[report.best_epoch - 1]["validation"] < 0.3 * report.rows[0]["validation"] + 0.05
    assert report.rows[report.best_epoch - 1]["validation"] == min(row["validation"] for row in report.rows)


def test_the_best_epoch_is_kept_and_patience_ends_it(tmp_path: Path) -> None:
    class Worsens(Line):
        calls = 0

        def loss(self, module, batch):
            if module.training:
                return super().loss(module, batch)
            self.calls += 1
            return super().loss(module, batch) * 0 + abs(self.calls - 3)

    module = network()
    report = fit(module, Worsens(), dataclasses.replace(SETTINGS, epochs=50, patience=4), folder=tmp_path)
    assert (report.best_epoch, len(report.rows)) == (3, 7)
    best = read_content(tmp_path / BEST)
    assert all(torch.equal(value, best[name]) for name, value in module.state_dict().items())


def test_a_killed_training_loses_an_epoch_at_most_and_ends_where_a_whole_one_does(tmp_path: Path) -> None:
    script = (
        "import time, torch\nfrom pathlib import Path\nfrom tests.guide3d.learning.test_training import *\n"
        "from guide3d.learning import training\n"
        "training._BETWEEN_CHECKPOINTS = 0.0\n"  # also on a machine so busy that writing takes long
        "def slow(now):\n    Path(r'{}').write_text(str(now.epoch))\n    time.sleep(0.3)\n"
        "fit(network(), Line(), SETTINGS, folder=r'{}', seed=3, progress=slow)\n"
    ).format(tmp_path / "epoch", tmp_path / "fit")
    process = subprocess.Popen([sys.executable, "-c", script], cwd=Path(__file__).parents[3])
    told = tmp_path / "epoch"
    until = time.monotonic() + 60
    while not (told.is_file() and told.read_text() >= "2"):
        assert time.monotonic() < until
        assert process.poll() is None
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    reached = int(told.read_text())
    kept = read_content(tmp_path / "fit" / LAST)["report"]["rows"]
    assert len(kept) >= reached
    whole, again = network(), network()
    expected = fit(whole, Line(), SETTINGS, folder=tmp_path / "whole", seed=3)
    report = fit(again, Line(), SETTINGS, folder=tmp_path / "fit", seed=3)
    assert [row["loss"] for row in report.rows] == [row["loss"] for row in expected.rows]
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), again.parameters(), strict=True))
    finished(tmp_path / "fit")
    assert not (tmp_path / "fit").exists()


def test_checkpoints_of_something_else_are_refused(tmp_path: Path) -> None:
    fit(network(), Line(), SETTINGS, folder=tmp_path)
    turned = Line()
    turned.validation_items = turned.validation_items[::-1]
    for module, line, settings, recipe, said in (
        (network(), Line(), dataclasses.replace(SETTINGS, batch_size=4), None, "of a training with other settings"),
        (network(), Line(), SETTINGS, {"mask_px": 30}, "of a training with other settings"),
        (network(), Line(16), SETTINGS, None, "of a training with other items"),
        (network(), turned, SETTINGS, None, "of a training with other items"),
        (torch.nn.Linear(1, 1), Line(), SETTINGS, None, "of another architecture"),
    ):
        with pytest.raises(TrainingError, match=said):
            fit(module, line, settings, folder=tmp_path, recipe=recipe)
    (tmp_path / LAST).write_bytes(b"torn")
    with pytest.raises(TrainingError, match=r"last\.pt is damaged or no checkpoint"):
        fit(network(), Line(), SETTINGS, folder=tmp_path)


def test_a_loss_that_is_no_number_ends_it(tmp_path: Path) -> None:
    class Broken(Line):
        def loss(self, module, batch):
            return super().loss(module, batch) * float("nan")

    with pytest.raises(TrainingError, match="the loss became nan in epoch 1"):
        fit(network(), Broken(), SETTINGS, folder=tmp_path)
    assert not (tmp_path / LAST).exists()
