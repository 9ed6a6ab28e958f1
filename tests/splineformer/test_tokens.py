"""Tokens of curves: round trips, loops, stubs, curves that leave the image, and their decoding in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from guide3d.geometry.bspline import BSplineCurve
from splineformer.decoding import basis, collocation, decode, padded, uniform_knots
from splineformer.tokens import (
    TokenSettings,
    curve_of_tokens,
    round_trip_px,
    sampled,
    tokens_of_curve,
    tokens_of_polyline,
)
from tests.splineformer.curves import loop, wavy_wire

SIDE = 1024


@pytest.mark.parametrize("points", [wavy_wire(1, SIDE), wavy_wire(2, SIDE), loop(SIDE)], ids=["wavy", "other", "loop"])
def test_round_trip(points: np.ndarray) -> None:
    tokens = tokens_of_polyline(points)
    assert tokens.shape[1] == 3
    assert 4 <= len(tokens) <= 23
    assert round_trip_px(points, tokens) < 0.5
    assert np.linalg.norm(tokens[0, 1:] - points[0]) < 1.0  # the first token's point is the tip


def test_limit_is_kept_and_costs_accuracy() -> None:
    points = loop(SIDE)
    few, many = tokens_of_polyline(points, TokenSettings(limit=7)), tokens_of_polyline(points)
    assert len(few) <= 7 < len(many)
    assert round_trip_px(points, few) > round_trip_px(points, many)


@pytest.mark.parametrize(
    "points",
    [[[10, 10], [13, 14]], [[10, 10], [10.5, 10]], [[10, 10], [11, 10], [12, 11]]],
    ids=["two points", "half a pixel", "three points"],
)
def test_stub(points: list[list[float]]) -> None:
    tokens = tokens_of_polyline(points)
    assert round_trip_px(points, tokens) < 0.5
    assert np.allclose(sampled(tokens, 5)[[0, -1]], np.asarray(points)[[0, -1]], atol=0.5)


def test_curve_outside_the_image_keeps_its_place() -> None:
    points = wavy_wire(3, SIDE) - [300.0, 0.0]
    assert (points[:, 0] < 0).any()
    assert round_trip_px(points, tokens_of_polyline(points)) < 0.5


def test_tokens_lose_nothing_of_a_spline() -> None:
    tokens = tokens_of_polyline(loop(SIDE))
    curve = curve_of_tokens(tokens)
    assert np.array_equal(tokens_of_curve(curve), tokens)
    assert np.array_equal(curve.knots[:4], np.zeros(4))
    assert len(curve.knots) == len(tokens) + 4


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (np.zeros((3, 3)), "at least 4"),
        (np.zeros((5, 3)), "above 0"),
        (np.full((5, 3), np.nan), "finite"),
    ],
)
def test_what_is_no_token_sequence(tokens: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        curve_of_tokens(tokens)


def test_what_is_no_curve() -> None:
    with pytest.raises(ValueError, match="at least 2 different points"):
        tokens_of_polyline([[3, 3], [3, 3]])
    with pytest.raises(ValueError, match="limit must be greater than or equal to 4, got 3"):
        TokenSettings(limit=3)
    line = BSplineCurve(np.array([0.0, 0, 1, 1]), np.array([[0.0, 0], [1, 1]]), 1)
    with pytest.raises(ValueError, match="expected a cubic"):
        tokens_of_curve(line)


def test_decoding_agrees_with_scipy() -> None:
    every = [tokens_of_polyline(points) for points in (wavy_wire(4, SIDE), loop(SIDE), np.array([[1.0, 1], [5, 9]]))]
    tokens, lengths = padded([torch.from_numpy(one) for one in every], 23)
    points = decode(tokens, lengths, 40).numpy()
    for decoded, one in zip(points, every, strict=True):
        assert np.abs(decoded - curve_of_tokens(one).sample(40)).max() < 2e-2


def test_decoding_is_differentiable_in_knots_and_points() -> None:
    tokens = torch.from_numpy(tokens_of_polyline(loop(SIDE)) / SIDE)[None]
    n = tokens.shape[1]
    inner, points = tokens[..., : n - 4, 0].clone().requires_grad_(), tokens[..., 1:].clone().requires_grad_()

    def curve(inner: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        # the last four knots are one number: moving one of them alone is no derivative
        knots = torch.cat([inner, tokens[..., n - 4 :, 0]], 1)
        return decode(torch.cat([knots[..., None], points], -1), torch.tensor([n]), 7)

    assert torch.autograd.gradcheck(curve, (inner, points), eps=1e-7, atol=1e-4)
    gradients = torch.autograd.grad(curve(inner, points).square().sum(), (inner, points))
    assert all((gradient != 0).any() for gradient in gradients)


def test_padding_does_not_matter() -> None:
    one = torch.from_numpy(tokens_of_polyline(wavy_wire(5, SIDE)))
    n = torch.tensor([len(one)])
    short, long = decode(one[None], n, 30), decode(padded([one], 40)[0], n, 30)
    assert torch.allclose(short, long)
    with pytest.raises(ValueError, match="expected 1 to 5"):
        padded([one], 5)


def test_basis_sums_to_one_and_fixed_knots_interpolate_the_ends() -> None:
    knots = uniform_knots(12, 0.5, torch.float64)
    assert len(knots) == 16
    assert (torch.diff(knots) >= 0).all()
    matrix = collocation(knots, torch.linspace(0, 1, 50, dtype=torch.float64))
    assert torch.allclose(matrix.sum(1), torch.ones(50, dtype=torch.float64))
    assert torch.allclose(matrix[[0, -1], [0, -1]], torch.ones(2, dtype=torch.float64), atol=1e-4)
    assert basis(knots[None], torch.tensor([[0.3]], dtype=torch.float64)).shape == (1, 1, 12)
