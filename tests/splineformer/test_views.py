"""Views: pictures and points turn alike, and the curve that agrees best with the picture is kept."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from splineformer.map_picture import map_picture
from splineformer.modeling.curve_network import CurveBatch, ImageKind
from splineformer.tokens import tokens_of_polyline
from splineformer.views import VIEWS, agreement, best_of_views, points_in, turned, turned_back
from tests.splineformer.curves import wavy_wire

SIDE = 64


def picture_of_curve(points: np.ndarray) -> np.ndarray:
    """A map of a wire along points, px, with its tip."""
    wire, tip = np.zeros((2, SIDE, SIDE), np.uint8)
    columns, rows = np.rint(points).astype(int).T.clip(0, SIDE - 1)
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


def test_agreement_prefers_the_whole_wire_and_its_tip() -> None:
    wire = wavy_wire(0, SIDE)
    picture = picture_of_curve(wire)
    whole = agreement(wire, picture)
    assert whole > agreement(wire[:100], picture)  # leaves wire out
    assert whole > agreement(wire + np.array([0.0, 3.0]), picture)  # beside it
    assert whole > agreement(wire[::-1], picture)  # the tip at the wrong end
    assert 0.0 <= agreement(np.array([[1.0, 1.0], [5.0, 1.0]]), np.full((SIDE, SIDE), 255, np.uint8)) <= 1.1


def test_the_best_view_is_kept() -> None:
    wire = wavy_wire(1, SIDE)
    picture = picture_of_curve(wire)
    tokens = tokens_of_polyline(wire)
    tokens[:, 1:] = (tokens[:, 1:] + 0.5) / SIDE
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
    assert best.error is not None
    assert float(best.error[0]) == pytest.approx(0.06)
    assert float(best.kind.wires[0, 1]) == pytest.approx(3.5)  # the mean
    assert np.allclose(best.tokens[0].numpy(), tokens, atol=1e-5)
    assert len(begun) == 1  # it was asked to read again, beginning with the best curve
    assert np.abs(begun[0] - (wire + 0.5) / SIDE).max() < 0.02
