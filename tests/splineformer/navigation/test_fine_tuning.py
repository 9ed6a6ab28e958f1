"""Fine-tuning of the perception network: it goes on from its weights, and its errors are those of held-out pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import resample
from splineformer.image_input import picture_of
from splineformer.navigation.fine_tuning import CURVE_POINTS, WirePictures, errors, fine_tune
from splineformer.predictor import Predictor
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.drawn_moments import perception_network


def shown(count: int = 6, held_out: int = 2) -> WirePictures:
    curves = [wavy_wire(seed) for seed in range(count)]
    pictures = np.stack([picture_of(image_of(curve), 64, 256).pixels for curve in curves])
    shares = np.stack([resample((curve + 0.5) / 256, count=CURVE_POINTS) for curve in curves])
    return WirePictures(pictures, shares, np.arange(count) >= count - held_out, 1)


def predictor() -> Predictor:
    return perception_network().predictor


def test_errors_are_those_of_the_held_out_pictures() -> None:
    wires = shown()
    found = errors(predictor(), wires)
    assert set(found) == {"tip_px", "mean_px", "median_tip_px", "median_mean_px"}
    tips = [reading.points[0] for reading in perception_network()(list(wires.pictures[4:]))]
    wanted = np.linalg.norm(1024 * (np.array(tips) - wires.curves[4:, 0]), axis=1)
    assert found["tip_px"] == pytest.approx(wanted.mean(), rel=1e-3)
    assert found["median_tip_px"] == pytest.approx(np.median(wanted), rel=1e-3)
    assert errors(predictor(), shown(held_out=0)) == {}


def test_weights_go_on_from_where_they_are_and_the_same_seed_gives_the_same(tmp_path: Path) -> None:
    before = {name: value.clone() for name, value in predictor().network.state_dict().items()}
    epochs, results = [], []
    for run in ("one", "other"):
        tuned, outcome = fine_tune(
            predictor(), shown(), "ordered", 1, folder=tmp_path / run, seed=3,
            progress=lambda now: epochs.append(now.epoch),
        )  # fmt: skip
        results.append((tuned.network.state_dict(), outcome))
    (weights, outcome), (twin, _) = results
    assert outcome["images"] == 6
    assert outcome["tip_px_before"] == pytest.approx(errors(predictor(), shown())["tip_px"])
    assert set(outcome) >= {"cpu_min", "tip_px_after", "median_mean_px_after"}
    assert epochs == [1, 1]
    assert any(not torch.equal(weights[name], before[name]) for name in before)
    assert all(torch.equal(weights[name], twin[name]) for name in weights)
