"""Tokens of curves: round trips, loops, stubs, curves that leave the image."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.geometry.bspline import BSplineCurve
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
