"""Augmentation: what lies inside, curves and images moved alike, wires removed, curves perturbed."""

from __future__ import annotations

import numpy as np
import torch

from guide3d.geometry.polyline import resample
from splineformer.image_input import pixels_of_shares, shares_of_pixels
from splineformer.learning.augmentation import (
    Augmentation,
    inside,
    moved,
    perturbed,
    recoloured,
    shadow,
    warped,
    without_wire,
)
from tests.splineformer.curves import image_of, wavy_wire


def test_part_inside_the_image() -> None:
    line = np.column_stack([np.linspace(0.5, 1.5, 11), np.full(11, 0.2)])
    kept = inside(line)
    assert np.allclose(kept[-1], [1.0, 0.2])
    assert inside(line[::-1]) is None  # the tip is outside
    assert inside(np.array([[0.5, 0.5], [0.501, 0.5]])) is None


def test_image_and_curve_move_alike() -> None:
    points, side = wavy_wire(4, SIDE := 256), SIDE
    image = torch.from_numpy(image_of(points, seed=1)).float()[None, None]
    share = shares_of_pixels(points, (side, side))
    new, where = moved(share, Augmentation(shift=0.1, turn_deg=20, stretch=0.2), np.random.default_rng(5))
    assert not np.allclose(new[0], share[0], atol=0.01)
    picture = warped(image, where[None])[0, 0].numpy()
    column, row = pixels_of_shares(resample(new, count=60)[3:-6], (side, side)).round().astype(int).T
    assert np.median(picture[row, column]) < np.median(picture[np.clip(row + 9, 0, side - 1), column]) - 40


def test_wire_is_taken_away() -> None:
    points = wavy_wire(4)
    image = torch.from_numpy(image_of(points)).float()[None]
    share = shares_of_pixels(points, (256, 256))
    empty = without_wire(image, share, np.random.default_rng(0))
    column, row = points.round().astype(int).T
    assert (empty[0, row, column] - image[0, row, column]).median() > 50
    assert (empty - image)[0, :20].abs().max() == 0  # elsewhere nothing changes
    assert shadow(image, empty)[0, row, column].median() < 0.7


def test_perturbation_is_smooth_and_of_different_size() -> None:
    points = torch.from_numpy(np.stack([wavy_wire(k, 1, 48) for k in range(12)])).float()
    moved = perturbed(points, np.random.default_rng(2)) - points
    size = moved.norm(dim=-1).mean(1)
    assert size.max() > 3 * size.min() > 0
    bend = (moved[:, 2:] + moved[:, :-2] - 2 * moved[:, 1:-1]).norm(dim=-1).mean(1)
    assert (bend < 0.3 * size).all()
    assert torch.equal(moved, perturbed(points, np.random.default_rng(2)) - points)


def test_augmentation_repeats_and_can_be_nothing() -> None:
    points = shares_of_pixels(wavy_wire(4), (256, 256))
    one, again = (moved(points, Augmentation(), np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(one[0], again[0])
    still = Augmentation(shift=0, turn_deg=0, stretch=0, gain=0, offset=0, noise=0, hidden=0)
    kept, where = moved(points, still, np.random.default_rng(1))
    assert np.allclose(kept, points)
    assert np.allclose(where, np.eye(2, 3))
    images = torch.full((2, 1, 32, 32), 100.0)
    assert torch.allclose(recoloured(images.clone(), still, np.random.default_rng(1)), images)


def test_a_curve_that_would_leave_keeps_its_place() -> None:
    corner = np.array([[0.001, 0.001], [0.02, 0.02]])
    kept, where = moved(corner, Augmentation(shift=0.0, turn_deg=0.0, stretch=0.0), np.random.default_rng(0))
    assert np.allclose(kept, corner)
    away = np.array([[2.0, 2.0], [3.0, 3.0]])  # no draw brings it in
    kept, where = moved(away, Augmentation(), np.random.default_rng(0))
    assert kept is away
    assert np.array_equal(where, np.eye(2, 3))


def test_grey_levels_stay_in_their_range_and_bars_hide() -> None:
    images = torch.from_numpy(np.stack([image_of(wavy_wire(k)) for k in range(4)]))[:, None].float()
    strong = Augmentation(gain=2.0, offset=100.0, noise=50.0)
    changed = recoloured(images.clone(), strong, np.random.default_rng(0))
    assert ((changed >= 0) & (changed <= 255)).all()
    bars = Augmentation(gain=0, offset=0, noise=0, hidden=1.0)
    hidden = recoloured(images.clone(), bars, np.random.default_rng(0)) - images
    shares = ((hidden.abs() > 0.01).float().mean((1, 2, 3))).tolist()
    assert all(0 < share < 0.15**2 + 0.01 for share in shares)
