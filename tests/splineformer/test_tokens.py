"""Tokens of curves: round trips, decoding, views."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from guide3d.geometry.bspline import BSplineCurve
from splineformer.decoding import decode
from splineformer.image_input import pixels_of_shares
from splineformer.map_picture import map_picture
from splineformer.modeling.curve_network import CurveBatch, ImageKind
from splineformer.tokens import (
    curve_of_tokens,
    round_trip_px,
    tokens_of_curve,
    tokens_of_polyline,
    tokens_px,
)
from splineformer.views import VIEWS, best_of_views, points_in, turned, turned_back
from tests.splineformer.curves import loop, wavy_wire

SIDE = 1024


@pytest.mark.parametrize("points", [wavy_wire(1, SIDE), wavy_wire(2, SIDE), loop(SIDE)], ids=["wavy", "other", "loop"])
def test_round_trip(points: np.ndarray) -> None:
    tokens = tokens_of_polyline(points)
    assert tokens.shape[1] == 3
    assert 4 <= len(tokens) <= 23
    assert round_trip_px(points, tokens) < 0.5
    assert np.linalg.norm(tokens[0, 1:] - points[0]) < 1.0  # the first token's point is the tip


@pytest.mark.parametrize(
    ("tokens", "message"),
    [(np.zeros((3, 3)), "at least 4"), (np.zeros((5, 3)), "above 0"), (np.full((5, 3), np.nan), "finite")],
)
def test_what_is_no_token_sequence(tokens: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        curve_of_tokens(tokens)


def test_what_is_no_curve() -> None:
    with pytest.raises(ValueError, match="at least 2 different points"):
        tokens_of_polyline([[3, 3], [3, 3]])
    line = BSplineCurve(np.array([0.0, 0, 1, 1]), np.array([[0.0, 0], [1, 1]]), 1)
    with pytest.raises(ValueError, match="expected a cubic"):
        tokens_of_curve(line)


def test_decoding_agrees_with_scipy() -> None:
    every = [tokens_of_polyline(points) for points in (wavy_wire(4, SIDE), loop(SIDE), np.array([[1.0, 1], [5, 9]]))]
    lengths = torch.tensor([len(one) for one in every])
    filled = [np.concatenate([one, np.full((23 - len(one), 3), 7.0)]) for one in every]  # is not looked at
    tokens = torch.from_numpy(np.stack(filled))
    points = decode(tokens, lengths, 40).numpy()
    for decoded, one in zip(points, every, strict=True):
        assert np.abs(decoded - curve_of_tokens(one).sample(40)).max() < 2e-2


def test_a_straight_curve_has_known_points() -> None:
    knots = torch.tensor([[1.0, 1, 1, 1]])  # one span: a Bézier curve
    line = torch.tensor([[[0.0, 0], [1, 2], [2, 4], [3, 6]]])
    points = decode(torch.cat([knots[..., None], line], -1), torch.tensor([4]), 4)[0]
    assert torch.allclose(points, line[0], atol=1e-4)
    bow = torch.tensor([[[0.0, 0], [0, 1], [1, 1], [1, 0]]])
    middle = decode(torch.cat([knots[..., None], bow], -1), torch.tensor([4]), 3)[0, 1]
    assert torch.allclose(middle, torch.tensor([0.5, 0.75]), atol=1e-5)  # (p0 + 3 p1 + 3 p2 + p3) / 8


def test_knots_out_of_order_are_put_in_order() -> None:
    tokens = torch.from_numpy(tokens_of_polyline(loop(SIDE)))[None].clone()
    n = torch.tensor([tokens.shape[1]])
    tokens[0, 2, 0] = tokens[0, 1, 0] - 50.0
    ordered = tokens.clone()
    ordered[0, 2, 0] = ordered[0, 1, 0]
    assert torch.allclose(decode(tokens, n, 40), decode(ordered, n, 40))
    assert torch.isfinite(decode(torch.zeros(1, 5, 3), torch.tensor([5]), 4)).all()  # all knots zero


def test_knots_that_are_all_zero_are_taken_as_equal() -> None:
    points = np.column_stack([np.linspace(0.1, 0.9, 8), np.full(8, 0.5)])
    tokens = tokens_px(np.column_stack([np.zeros(8), points]), 100.0)
    curve = curve_of_tokens(tokens)
    np.testing.assert_allclose(curve.sample(2)[0], pixels_of_shares(points[:1], (100.0, 100.0))[0], atol=1e-9)
    assert np.diff(curve.knots).min() >= 0


VIEWS_SIDE = 64


def picture_of_curve(points: np.ndarray) -> np.ndarray:
    """A map of a wire along points, px, with its tip."""
    wire, tip = np.zeros((2, VIEWS_SIDE, VIEWS_SIDE), np.uint8)
    columns, rows = np.rint(points).astype(int).T.clip(0, VIEWS_SIDE - 1)
    wire[rows, columns] = 255
    tip[rows[0], columns[0]] = 255
    return map_picture(wire, tip)


@pytest.mark.parametrize("view", range(VIEWS))
def test_points_turn_back_to_their_pixel(view: int) -> None:
    levels = torch.zeros(1, 1, 8, 8)
    levels[0, 0, 2, 5] = 1.0
    row, column = np.argwhere(turned(levels, view)[0, 0].numpy() == 1)[0]
    place = turned_back((np.array([column, row]) + 0.5) / 8, view)
    assert np.allclose(place, np.array([5.5, 2.5]) / 8)
    assert np.allclose(points_in(place, view), (np.array([column, row]) + 0.5) / 8)


def test_the_best_view_is_kept() -> None:
    wire = wavy_wire(1, VIEWS_SIDE)
    picture = picture_of_curve(wire)
    tokens = tokens_of_polyline(wire)
    tokens[:, 1:] = (tokens[:, 1:] + 0.5) / VIEWS_SIDE
    calls = []

    def read(levels: torch.Tensor) -> CurveBatch:
        view = len(calls)
        calls.append(levels)
        found = torch.full((1, len(tokens), 3), 0.5)
        if view == 6:  # the only view in which the network reads well
            ways = torch.from_numpy(tokens.copy()).float()
            ways[:, 1:] = torch.from_numpy(points_in(tokens[:, 1:], 6)).float()
            found = ways[None]
        else:
            found[..., 0] = torch.linspace(0.1, 1.0, len(tokens))
            found[..., 1] = torch.linspace(0.1, 0.9, len(tokens))
        kind = ImageKind(torch.tensor([[0.0, float(view), 0.0]]), torch.zeros(1))
        quality, error = torch.tensor([float(view)]), torch.tensor([view / 100])
        return CurveBatch(found, torch.tensor([len(tokens)]), torch.zeros(1, 4, 2), kind, quality, error)

    begun = []

    def read_again(levels: torch.Tensor, curves: torch.Tensor) -> None:
        begun.append(curves[0].numpy())

    network = SimpleNamespace(read=read, read_again=read_again)
    best = best_of_views(network, torch.from_numpy(picture)[None, None].float())  # type: ignore[arg-type]
    assert len(calls) == VIEWS
    assert float(best.quality[0]) == 6.0
    assert float(best.error[0]) == pytest.approx(0.06)
    assert float(best.kind.wires[0, 1]) == pytest.approx(3.5)  # the mean
    assert np.allclose(best.tokens[0].numpy(), tokens, atol=1e-5)
    assert len(begun) == 1  # it was asked to read again, beginning with the best curve
    assert np.abs(begun[0] - (wire + 0.5) / VIEWS_SIDE).max() < 0.02
