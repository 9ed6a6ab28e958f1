"""Samples: batches that a generator determines, curves met oftener, images that cannot be read."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from guide3d.dataset.dataset import Dataset, images_of
from splineformer.build import VARIANTS, build, size_of
from splineformer.learning.augmentation import (
    Augmentation,
)
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective, curves_of, passes_of
from tests.guide3d.learning.drawn_data import draw


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def test_wires_that_turn_much_are_met_oftener() -> None:
    straight = np.linspace([0.9, 0.5], [0.0, 0.5], 200)
    around = np.linspace(0.0, 4 * np.pi, 600)  # twice, so 12.6 rad
    coil = 0.5 + np.column_stack([0.1 * np.cos(around) + 0.002 * around, 0.1 * np.sin(around)])
    assert passes_of(straight, 3.0) == 1
    assert passes_of(coil, 3.0) == passes_of(coil[::-1], 3.0) == 4
    assert passes_of(straight[:2], 3.0) == 1
    assert passes_of(coil, 0.0) == 1
    assert recipe_of("published", "thesis").augmentation.turn_a_pass == 0.0  # trained as published


@pytest.mark.parametrize("variant", VARIANTS)
def test_batches_are_determined_by_the_generator(variant: str, data: Dataset) -> None:
    network = build(size_of(variant, "smoke"))
    names = list(data.acquisitions)

    class Store:
        def __init__(self, camera: str) -> None:
            self.camera = camera

        def healthy(self, indices: np.ndarray) -> np.ndarray:
            return indices != 1

        def pictures(self, indices: np.ndarray) -> np.ndarray:
            return np.stack([data.frames[i].image(self.camera)[::2, ::2] for i in indices])

    curves = curves_of(data)
    objective = SplineObjective(
        [Store("a"), Store("b")], curves, images_of(data, names[:4]), images_of(data, names[4:]), network,
        augmentation=Augmentation(turn_a_pass=0.5), source_px=128,
    )  # fmt: skip
    known = images_of(data, names[:4])
    assert objective.training_items.tolist() == [i for i in known for _ in range(passes_of(np.asarray(curves[i]), 0.5))]
    assert len(objective.training_items) > len(known)
    items = objective.training_items[:6]
    one, two = (objective.batch(items, np.random.default_rng(3)) for _ in range(2))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not torch.equal(one["images"], objective.batch(items, np.random.default_rng(4))["images"])
    plain = objective.batch(items, None)
    assert (plain["wires"] == 1).all()
    loss = objective.loss(network, plain)
    loss.backward()
    assert torch.isfinite(loss)
    assert 1 in items  # the frame that cannot be read was replaced
    with pytest.raises(ValueError, match="training part is empty"):
        SplineObjective([Store("a"), Store("b")], curves, items[:0], items, network)
