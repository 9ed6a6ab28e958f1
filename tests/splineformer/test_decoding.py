"""Decoding of tokens in torch: values, gradients, padding, fixed knots."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.decoding import basis, collocation, decode, padded, uniform_knots
from splineformer.tokens import (
    curve_of_tokens,
    tokens_of_polyline,
)
from tests.splineformer.curves import loop, wavy_wire

SIDE = 1024


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


def test_a_straight_curve_has_known_points() -> None:
    knots = torch.tensor([[1.0, 1, 1, 1]])  # one span: a Bézier curve
    line = torch.tensor([[[0.0, 0], [1, 2], [2, 4], [3, 6]]])
    points = decode(torch.cat([knots[..., None], line], -1), torch.tensor([4]), 4)[0]
    assert torch.allclose(points, line[0], atol=1e-4)
    bow = torch.tensor([[[0.0, 0], [0, 1], [1, 1], [1, 0]]])
    middle = decode(torch.cat([knots[..., None], bow], -1), torch.tensor([4]), 3)[0, 1]
    assert torch.allclose(middle, torch.tensor([0.5, 0.75]), atol=1e-5)  # (p0 + 3 p1 + 3 p2 + p3) / 8


def test_tokens_beyond_the_length_and_the_scale_of_knots_do_not_matter() -> None:
    one = torch.from_numpy(tokens_of_polyline(wavy_wire(5, SIDE)))[None]
    n = torch.tensor([one.shape[1]])
    points = decode(one, n, 30)
    junk = torch.cat([one, torch.full((1, 4, 3), 1e6, dtype=one.dtype)], 1)
    assert torch.equal(decode(junk, n, 30), points)
    scaled = one * torch.tensor([0.01, 1.0, 1.0])
    assert torch.allclose(decode(scaled, n, 30), points, atol=1e-6)


def test_knots_out_of_order_are_put_in_order() -> None:
    tokens = torch.from_numpy(tokens_of_polyline(loop(SIDE)))[None].clone()
    n = torch.tensor([tokens.shape[1]])
    tokens[0, 2, 0] = tokens[0, 1, 0] - 50.0
    ordered = tokens.clone()
    ordered[0, 2, 0] = ordered[0, 1, 0]
    assert torch.allclose(decode(tokens, n, 40), decode(ordered, n, 40))
    assert torch.isfinite(decode(torch.zeros(1, 5, 3), torch.tensor([5]), 4)).all()  # all knots zero


def test_denser_knots_at_the_tip() -> None:
    spans = torch.diff(uniform_knots(12, 0.5, torch.float64)[3:-3])
    assert spans[0] < spans[-1]
    assert torch.allclose(torch.diff(uniform_knots(12, 1.0, torch.float64)[3:-3]), torch.full((9,), 1 / 9).double())
