"""The perception network is trained and read on another device than the CPU."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.distributed import Ranks
from guide3d.learning.training import fit
from splineformer.attention import attention_map
from splineformer.build import VARIANTS
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective
from splineformer.navigation.perception import PerceptionNetwork
from splineformer.predictor import Predictor
from tests.second_device import second_device, tolerance
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.drawn_moments import perception_network


@pytest.mark.parametrize("variant", VARIANTS)
def test_reading_on_another_device(variant: str, tmp_path: Path) -> None:
    images = [image_of(wavy_wire(seed)) for seed in (0, 1)]
    here = perception_network(variant)
    readings, seen = here(images), attention_map(here.predictor, images[0])
    here.predictor.save(tmp_path / "predictor.pt")
    with second_device() as device:
        network = PerceptionNetwork(Predictor.load(tmp_path / "predictor.pt", device=device))
        for there, reading in zip(network(images), readings, strict=True):
            for name in ("tokens", "points", "encoded"):
                np.testing.assert_allclose(getattr(there, name), getattr(reading, name), atol=1e-4)
        drawn = network.predictor.batch(images)
        np.testing.assert_allclose(attention_map(network.predictor, images[0]), seen, atol=1e-4)
    for there, here_too in zip(drawn, here.predictor.batch(images), strict=True):
        assert there.wires == here_too.wires
        assert there.confidence == pytest.approx(here_too.confidence, abs=1e-4)


class _Drawn:
    def healthy(self, indices: np.ndarray) -> np.ndarray:
        return np.ones(len(indices), bool)

    def pictures(self, indices: np.ndarray) -> np.ndarray:
        return np.stack([image_of(wavy_wire(int(seed)))[::4, ::4] for seed in indices]).astype(np.uint8)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_network_is_trained_further_on_another_device(variant: str, tmp_path: Path) -> None:
    recipe = recipe_of(variant, "smoke")
    settings = replace(recipe.fit, epochs=1, batch_size=2)
    curves = [(wavy_wire(seed) + 0.5) / 256 for seed in range(4)]
    losses = {}
    with second_device() as device:
        for place in ("cpu", device):
            network = Predictor(perception_network(variant).network, source_px=256, device=place).network
            objective = SplineObjective(
                [_Drawn()], curves, np.arange(2), np.arange(2, 4), network,
                augmentation=recipe.augmentation,
            )  # fmt: skip
            ranks = Ranks(0, 1, torch.device(place))
            report = fit(network, objective, settings, folder=tmp_path / place[:3], seed=1, ranks=ranks)
            losses[place] = [report.rows[0]["loss"], report.rows[0]["validation"]]
    assert losses["cpu"] == pytest.approx(losses[device], rel=tolerance(1e-3, gpu=0.02))  # mixed precision
