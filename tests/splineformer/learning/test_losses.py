"""Losses: known values at known places."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.learning.losses import attention_loss, nearest_on_curve, offset_loss


def test_attention_loss_is_least_at_the_true_place() -> None:
    points = torch.tensor([[[0.30, 0.70]]])
    side = 8
    cells = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1)
    distance = (cells - (points[0] * side - 0.5)).norm(dim=1)
    right, wrong = -(distance**2), -((distance - 3) ** 2)
    assert attention_loss(right[None, None], points) < attention_loss(wrong[None, None], points)
    assert attention_loss(torch.zeros(1, 1, side**2), points).item() == pytest.approx(np.log(side**2), rel=1e-5)


def test_nearest_places_on_a_curve() -> None:
    curve = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]])
    points = torch.tensor([[[0.3, 0.2], [2.0, 0.4], [-1.0, -1.0]]])
    assert torch.allclose(nearest_on_curve(points, curve), torch.tensor([[[0.3, 0.0], [1.0, 0.4], [0.0, 0.0]]]))


def test_nearest_places_on_the_own_strand() -> None:
    # there and back: the strand beside is nearer, but belongs to another part of the length
    there = torch.stack([torch.linspace(0, 1, 21), torch.zeros(21)], -1)
    back = torch.stack([torch.linspace(1, 0, 21), torch.full((21,), 0.1)], -1)
    curve = torch.cat([there, back])[None]
    point = torch.tensor([[[0.4, 0.08]]])
    assert torch.allclose(nearest_on_curve(point, curve)[0, 0], torch.tensor([0.4, 0.1]), atol=1e-6)
    own = nearest_on_curve(point, curve, torch.tensor([0.2]), 0.1)[0, 0]
    assert torch.allclose(own, torch.tensor([0.4, 0.0]), atol=1e-6)


def test_offsets_are_right_where_they_point_to_the_place() -> None:
    side, point = 4, torch.tensor([[0.30, 0.70]])
    centres = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1) + 0.5
    right = (point * side - centres)[None]
    assert offset_loss(right, point).item() == pytest.approx(0, abs=1e-3)
    # half a cell is 12.5 hundredths of the side
    assert offset_loss(right + torch.tensor([0.5, 0.0]), point).item() == pytest.approx(12.5, rel=0.02)
