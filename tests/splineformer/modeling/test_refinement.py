"""Revisions and refinements: they turn with the curve, and keep to the points they are given."""

from __future__ import annotations

import pytest
import torch

from splineformer.modeling.refinement import Refinement, Revision, at_equal_shares
from tests.splineformer.curves import wavy_wire


def test_refinement_turns_with_the_curve() -> None:
    torch.manual_seed(0)
    step = Refinement(2, 1 / 32, 2, 16)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    features = torch.rand(1, 2, 32, 32)
    points = torch.from_numpy(wavy_wire(0, 1, 12)).float()[None] * 0.6 + 0.2
    moved = step(features, points)[0] - points
    turned = step(features.rot90(1, (2, 3)), torch.stack([points[..., 1], 1 - points[..., 0]], -1))[0]
    there = torch.stack([points[..., 1], 1 - points[..., 0]], -1)
    assert torch.allclose(turned - there, torch.stack([moved[..., 1], -moved[..., 0]], -1), atol=1e-5)


def test_points_at_shares_of_the_length() -> None:
    points = torch.tensor([[[0.0, 0.0], [0.3, 0.0], [0.3, 0.1]], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.4]]])
    found = at_equal_shares(points, torch.tensor([0.0, 0.375, 0.875, 1.0]))
    assert torch.allclose(found[0], torch.tensor([[0.0, 0.0], [0.15, 0], [0.3, 0.05], [0.3, 0.1]]), atol=1e-6)
    assert torch.allclose(found[1], torch.tensor([[0.0, 0.0], [0, 0.15], [0, 0.35], [0, 0.4]]), atol=1e-6)


def test_new_steps_move_nothing() -> None:
    torch.manual_seed(0)
    points, fine = torch.rand(2, 12, 2), torch.rand(2, 3, 16, 16)
    moved, seen = Refinement(3, 1 / 16, 2, 8)(fine, points)
    assert torch.equal(moved, points)
    assert seen.shape == (2, 12, 8)
    assert torch.equal(Revision(3, 8, 2, 1, 12, 1 / 16, 2)(fine, torch.rand(2, 8, 4, 4), points), points)


def test_what_lies_out_of_sight_does_not_move_a_point() -> None:
    torch.manual_seed(0)
    step = Refinement(1, 1 / 32, 2, 8)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    points = torch.linspace(0.2, 0.4, 12)[None, :, None].expand(1, 12, 2)
    plain = torch.zeros(1, 1, 32, 32)
    far, near = plain.clone(), plain.clone()
    far[..., 24:, 24:] = 1.0
    near[..., 8:12, 8:12] = 1.0
    assert step.sight == pytest.approx(3 / 32)
    assert torch.equal(step(far, points)[0], step(plain, points)[0])
    assert not torch.equal(step(near, points)[0], step(plain, points)[0])


def test_in_a_revision_points_see_each_other() -> None:
    torch.manual_seed(0)
    step = Revision(1, 8, 2, 1, 6, 1 / 16, 1)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    fine, coarse, points = torch.zeros(1, 1, 16, 16), torch.zeros(1, 8, 4, 4), torch.rand(1, 6, 2)
    other = points.clone()
    other[0, 5] += 0.2
    moved, otherwise = step(fine, coarse, points), step(fine, coarse, other)
    assert not torch.allclose(moved[0, 0], otherwise[0, 0])  # the first point knows where the last one is
