"""Losses of the networks: nothing where all is right, known values elsewhere, padding without a say."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from guide3d.learning.losses import ShapeLoss, fgrn_loss, segmentation_loss, stop_loss
from guide3d.modeling.shape_network import PredictedShapes


def shapes(points: torch.Tensor, offsets: torch.Tensor, last: torch.Tensor) -> PredictedShapes:
    logits = torch.full(points.shape[:2], -40.0)
    logits[torch.arange(len(last)), last] = 40.0
    return PredictedShapes(points[:, 0], offsets, points, logits)


def test_shape_loss_weighs_its_parts_and_ignores_padding() -> None:
    torch.manual_seed(0)
    points, offsets, last = 10 * torch.randn(3, 6, 3), torch.randn(3, 5, 2), torch.tensor([5, 3, 2])
    right = shapes(points, offsets, last)
    loss = ShapeLoss(tip=1.0, offset=2.0, stop=1.0, curve=3.0)
    assert loss(right, points, offsets, last) == pytest.approx(0.0, abs=1e-4)
    padded = points.clone()
    padded[2, 3:] += 100.0
    told = offsets.clone()
    told[2, 2:] += 5.0
    assert loss(right, padded, told, last) == pytest.approx(0.0, abs=1e-4)
    turned = offsets.clone()
    turned[0, 0, 0] += 1.0  # one of five steps, of weight 2
    assert loss(right, points, turned, last)[0] == pytest.approx(2.0 / 5, abs=1e-4)
    moved = points + torch.tensor([10.0, 0, 0])  # 1 cm: tip 1, curve 3
    assert loss(right, moved, offsets, last) == pytest.approx(4.0, abs=1e-3)


def test_robust_shape_loss_counts_distances_from_the_entry_on() -> None:
    torch.manual_seed(0)
    points, last = 10 * torch.randn(2, 6, 3), torch.tensor([5, 3])
    offsets = torch.zeros(2, 5, 2)
    logits = torch.full((2, 6), -40.0)
    logits[torch.arange(2), last] = 40.0
    tips = points[torch.arange(2), last]
    loss = ShapeLoss(tip=1.0, offset=0.0, stop=0.0, curve=2.0, length=0.5, robust=True)
    right = PredictedShapes(tips, offsets, points, logits)
    assert loss(right, points, offsets, last, "entry") == pytest.approx(0.0, abs=1e-4)
    far = PredictedShapes(tips + torch.tensor([0.0, 400.0, 0.0]), offsets, points, logits)
    assert loss(far, points, offsets, last, "entry") == pytest.approx(40.0 - 0.1, abs=1e-2)  # cm, less what is near
    assert loss(far, points, offsets, last, "tip")[0] > 1.0  # the first point is no tip here
    flat = PredictedShapes(tips, offsets, points, torch.zeros(2, 6))
    assert loss(flat, points, offsets, last, "entry").tolist() == pytest.approx([0.5 * 2.5, 0.5 * 0.5])


def test_stop_loss_is_binary_cross_entropy_over_positions() -> None:
    logits, last = torch.zeros(1, 4), torch.tensor([1])
    assert stop_loss(logits, last)[0] == pytest.approx(-math.log(0.25) - 3 * math.log(0.75))
    assert torch.isfinite(stop_loss(torch.tensor([[1000.0, -1000.0]]), torch.tensor([1]))).all()


def test_fgrn_loss_is_huber_and_spacing_in_metres() -> None:
    line = torch.zeros(1, 5, 3)
    line[0, :, 0] = 2.0 * torch.arange(5)
    last = torch.tensor([4])
    assert fgrn_loss(line, line, last)[0] == 0.0
    away = line + torch.tensor([0, 0, 30.0])  # 30 mm in one of three coordinates
    assert fgrn_loss(away, line, last)[0] == pytest.approx(1000 * 0.5 * 0.03**2 / 3)
    stretched = 1.5 * line  # 3 mm apart instead of 2
    expected = 1000 * 0.5 * np.square(0.001 * np.arange(5)).mean() / 3 + 0.001
    assert fgrn_loss(stretched, line, last)[0] == pytest.approx(expected, rel=1e-4)
    far = line.clone()
    far[0, 3:] += 99.0
    assert fgrn_loss(line, far, torch.tensor([2]))[0] == 0.0


def test_segmentation_loss_falls_towards_the_mask() -> None:
    mask = torch.zeros(1, 1, 8, 8)
    mask[..., 3] = 1
    losses = [float(segmentation_loss(k * (2 * mask - 1), mask)) for k in (-5.0, 0.0, 5.0, 20.0)]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] == pytest.approx(0.0, abs=1e-3)
    assert float(segmentation_loss(torch.zeros_like(mask), mask, dice=0.0)) == pytest.approx(math.log(2), rel=1e-5)
