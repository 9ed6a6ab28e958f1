"""The navigator and the network that it sees with are trained and read on another device than the CPU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.distributed import Ranks
from guide3d.learning.training import fit
from splineformer.build import VARIANTS
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective
from splineformer.navigation.cloning import CloningSettings, clone
from splineformer.navigation.navigator import Navigator
from splineformer.navigation.perception import Reader
from splineformer.predictor import Predictor
from tests.second_device import second_device
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.test_navigator import drawn_episodes, reader, settings_of


@pytest.mark.parametrize("variant", VARIANTS)
def test_reading_on_another_device(variant: str, tmp_path: Path) -> None:
    images = [image_of(wavy_wire(seed)) for seed in (0, 1)]
    here = reader(variant)
    readings = here(images)
    here.predictor.save(tmp_path / "eye.pt")
    with second_device() as device:
        eye = Reader(Predictor.load(tmp_path / "eye.pt", device=device))
        for there, reading in zip(eye(images), readings, strict=True):
            for name in ("tokens", "points", "memory"):
                np.testing.assert_allclose(getattr(there, name), getattr(reading, name), atol=1e-4)
        drawn = eye.predictor.batch(images)
    for there, here_too in zip(drawn, here.predictor.batch(images), strict=True):
        assert there.wires == here_too.wires
        assert there.confidence == pytest.approx(here_too.confidence, abs=1e-4)


def test_navigator_on_another_device(tmp_path: Path) -> None:
    settings = settings_of(reader())
    cloning, losses, acts = CloningSettings(epochs=2, batch_size=4), {}, {}
    episodes = drawn_episodes(settings, 5)
    looks = episodes[0].looks[:2]
    with second_device() as device:
        for place in ("cpu", device):
            eye = Reader(Predictor(reader().network, source_px=256, device=place))
            navigator = Navigator(replace(settings, dropout=0.0), eye, seed=1)
            losses[place] = clone(navigator, episodes, cloning, seed=1)
            acts[place], recalled = navigator.act(looks)
            assert recalled.device == navigator.device == torch.device(place)
            navigator.save(tmp_path / "navigator.pt")
            read = Navigator.load(tmp_path / "navigator.pt", eye)
            np.testing.assert_allclose(read.act(looks, recalled)[0], navigator.act(looks, recalled)[0], atol=1e-5)
    assert losses["cpu"] == pytest.approx(losses[device], rel=1e-3)
    np.testing.assert_allclose(acts["cpu"], acts[device], atol=1e-4)
    Navigator.load(tmp_path / "navigator.pt", reader())


class _Drawn:
    def healthy(self, indices: np.ndarray) -> np.ndarray:
        return np.ones(len(indices), bool)

    def pictures(self, indices: np.ndarray) -> np.ndarray:
        return np.stack([image_of(wavy_wire(int(seed)))[::4, ::4] for seed in indices]).astype(np.uint8)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_eye_goes_on_learning_on_another_device(variant: str, tmp_path: Path) -> None:
    recipe = recipe_of(variant, "smoke")
    settings = replace(recipe.fit, epochs=1, batch_size=2)
    curves = [(wavy_wire(seed) + 0.5) / 256 for seed in range(6)]
    losses = {}
    with second_device() as device:
        for place in ("cpu", device):
            network = Predictor(reader(variant).network, source_px=256, device=place).network
            objective = SplineObjective(
                [_Drawn()], curves, np.arange(4), np.arange(4, 6), network,
                augmentation=recipe.augmentation, weights=recipe.weights, source_px=256,
            )  # fmt: skip
            ranks = Ranks(0, 1, torch.device(place))
            report = fit(network, objective, settings, folder=tmp_path / place[:3], seed=1, ranks=ranks)
            losses[place] = [report.rows[0]["loss"], report.rows[0]["validation"]]
    assert losses["cpu"] == pytest.approx(losses[device], rel=1e-3)
