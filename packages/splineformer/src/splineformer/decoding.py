"""Decoding of spline tokens in torch: points of clamped cubic B-splines, differentiable in knots and control points."""

from __future__ import annotations

import torch
from torch import Tensor

DEGREE = 3
_BEFORE_END = 1e-6  # share of the length: the basis is open at its end


def basis(knots: Tensor, u: Tensor) -> Tensor:
    """(B, S, n) values of the cubic basis functions by the recursion of Cox and de Boor.

    Args:
        knots: (B, n + 4), ascending.
        u: (B, S) parameters, from the first knot to just before the last.

    Source:
        de Boor, A Practical Guide to Splines (1978), chapter IX.
    """
    t, x = knots[:, None, :], u[:, :, None]
    values = ((x >= t[..., :-1]) & (x < t[..., 1:])).to(knots.dtype)
    for degree in range(1, DEGREE + 1):
        left, right = t[..., degree:-1] - t[..., : -degree - 1], t[..., degree + 1 :] - t[..., 1:-degree]
        # a span of no length has no share: its quotient is 0, and so are its gradients
        rising = torch.where(left > 0, (x - t[..., : -degree - 1]) / torch.where(left > 0, left, 1.0), 0.0)
        falling = torch.where(right > 0, (t[..., degree + 1 :] - x) / torch.where(right > 0, right, 1.0), 0.0)
        values = rising * values[..., :-1] + falling * values[..., 1:]
    return values


def decode(tokens: Tensor, lengths: Tensor, count: int) -> Tensor:
    """(B, count, 2) points of the tokens' curves at equal steps of the parameter, tip first, both ends among them.

    Args:
        tokens: (B, n, 3) knot, x, y, of any scale; what lies beyond the lengths is not looked at.
        lengths: (B,) tokens of each, at least four.
    """
    place = torch.arange(tokens.shape[1], device=tokens.device)[None]
    last = (lengths - 1)[:, None].to(tokens.device)
    held = tokens.gather(1, torch.minimum(place, last)[..., None].expand(-1, -1, 3))
    knots = torch.cummax(held[..., 0].clamp_min(0.0), dim=1).values
    end = knots[:, -1:].clamp_min(1e-6)
    # the curve ends at its last control point only if the last four knots agree
    knots = torch.where(place > last - (DEGREE + 1), end, knots.minimum(end))
    full = torch.cat([torch.zeros_like(knots[:, : DEGREE + 1]), knots], dim=1)
    steps = torch.linspace(0.0, 1.0 - _BEFORE_END, count, dtype=tokens.dtype, device=tokens.device)
    return basis(full, steps[None] * end) @ held[..., 1:]


def uniform_knots(count: int, denser_at_tip: float = 1.0, dtype: torch.dtype = torch.float32) -> Tensor:
    """The (count + 4,) clamped knots in 0 to 1 that the parallel decoder uses.

    Args:
        denser_at_tip: length of the first span over that of equal spans; 1: all are equal.
    """
    inner = torch.linspace(0.0, 1.0, count - DEGREE + 1, dtype=torch.float64)
    inner = inner * (denser_at_tip + (1.0 - denser_at_tip) * inner)
    ends = torch.zeros(DEGREE, dtype=torch.float64)
    return torch.cat([ends, inner, ends + 1.0]).to(dtype)


def collocation(knots: Tensor, u: Tensor) -> Tensor:
    """The (S, n) matrix that takes control points to the points at parameters u of one knot vector in 0 to 1."""
    return basis(knots.double()[None], u.double().clamp(0.0, 1.0 - _BEFORE_END)[None])[0].to(knots.dtype)
