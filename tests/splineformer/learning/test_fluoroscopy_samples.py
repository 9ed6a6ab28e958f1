"""Samples of random fluoroscopy: pictures move with their curves, and a generator determines a batch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.build import VARIANTS, build, size_of
from splineformer.learning.augmentation import Augmentation
from splineformer.learning.fluoroscopy_pool import NONE, ONE, FluoroscopyPool
from splineformer.learning.fluoroscopy_samples import FluoroscopyObjective

SIDE = 64
TURNED = Augmentation(
    shift=0.1, turn_deg=180.0, stretch=0.2, gain=0.0, offset=0.0, noise=0.0, hidden=0.0, inverted=0.0, empty=0.0,
    several=0.0,
)  # fmt: skip


def pool_of(count: int) -> FluoroscopyPool:
    """White pictures with a dark horizontal line from the middle to the right border; the last one is empty."""
    pictures = np.full((count, SIDE, SIDE), 255, np.uint8)
    pictures[:-1, 31:33, SIDE // 2 :] = 60
    curve = np.column_stack([np.linspace(0.5, 1.0, 240), np.full(240, 0.5)])
    curves = np.repeat(curve[None], count, 0)
    curves[-1] = np.nan
    wires = np.array([ONE] * (count - 1) + [NONE])
    return FluoroscopyPool(pictures, curves, wires)


def objective_of(variant: str, drawn: float) -> FluoroscopyObjective:
    torch.manual_seed(0)
    network = build(size_of(variant, "smoke"))
    return FluoroscopyObjective(
        pool_of(4), pool_of(3), network, samples=40, drawn=drawn, augmentation=TURNED, background=255, source_px=256
    )


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("drawn", [0.0, 0.5, 1.0])
def test_batches_are_determined_by_the_generator(variant: str, drawn: float) -> None:
    objective = objective_of(variant, drawn)
    one, two = (objective.batch(objective.training_items[:8], np.random.default_rng(1)) for _ in range(2))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert len(one["images"]) == 8
    assert torch.isfinite(objective.loss(build(size_of(variant, "smoke")), one))
    plain = objective.batch(objective.validation_items, None)
    assert plain["wires"].tolist() == [ONE, ONE, NONE]


def test_pictures_move_with_their_curves() -> None:
    objective = objective_of("ordered", 0.0)
    batch = objective.batch(objective.training_items[:32], np.random.default_rng(2))
    directions = []
    for image, points, wires in zip(batch["images"], batch["points"], batch["wires"], strict=True):
        assert float(image.max()) == 255.0  # what comes in is white
        if wires == ONE:
            column, row = np.clip(points.numpy() * SIDE, 0, SIDE - 1).astype(int).T
            assert np.median(image[0].numpy()[row, column]) < 160
            directions.append((points[-1] - points[0]).numpy())
    assert len(directions) > 10
    assert np.ptp(np.array(directions), axis=0).min() > 0.4  # every way


def test_nothing_to_learn_from() -> None:
    empty = FluoroscopyPool(np.zeros((0, SIDE, SIDE), np.uint8), np.zeros((0, 240, 2)), np.zeros(0, np.int64))
    network = build(size_of("ordered", "smoke"))
    with pytest.raises(ValueError, match="no image to learn from"):
        FluoroscopyObjective(empty, empty, network, samples=4, drawn=0.5, augmentation=TURNED, background=255)
