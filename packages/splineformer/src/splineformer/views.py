"""Views: one picture turned and mirrored in the eight ways that keep its grid, and which curve agrees with it best.

A network that learnt from pictures turned every way reads all eight equally well, but not equal in every picture. The
maps say which curve runs where wire is, leaves none out, and begins at a tip.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2
from splineformer.map_picture import TIP, WHITE, WIRE
from splineformer.modeling.curve_network import CurveBatch, CurveNetwork, ImageKind
from splineformer.tokens import sampled, tokens_px

VIEWS = 8
_QUARTERS = 4
_NEAR_CELLS = 2  # to each side of a curve, what belongs to it
_TIP_WEIGHT = 0.1
_POINTS = 200
_ROUNDS = 3
_SHIFT = 4  # binary places of a pixel in what is drawn


def turned(levels: Tensor, view: int) -> Tensor:
    """(B, 1, s, s) pictures in a view of 0 to 7: quarters of a turn, from 4 on mirrored, too."""
    levels = torch.rot90(levels, view % _QUARTERS, (2, 3))
    return levels.flip(3) if view >= _QUARTERS else levels


def turned_back(points: NDArray[np.floating], view: int) -> NDArray[np.floating]:
    """Takes points (..., 2) of a view, shares of the side, to those of the picture."""
    x, y = points[..., 0], points[..., 1]
    if view >= _QUARTERS:
        x = 1.0 - x
    for _ in range(view % _QUARTERS):
        x, y = 1.0 - y, x
    return np.stack([x, y], -1)


def agreement(places: Array, picture: NDArray[np.uint8]) -> float:
    """How well a curve agrees with a picture of maps, 0 to 1.1.

    Args:
        places: (n, 2) px of the picture, at equal arc length, tip first.
        picture: (size, size).

    Returns:
        The harmonic mean of the share of the curve on wire and the share of the wire on the curve; a tenth of the map
        of tips at the first point is added.
    """
    size = len(picture)
    dark = (WHITE - picture.astype(np.float32)) / np.float32(WIRE)
    column, row = (np.ascontiguousarray(axis, np.float32)[None] for axis in places.T)
    along = cv2.remap(dark, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)[0]
    curve = np.zeros((size, size), np.uint8)
    line = np.rint(places * 2**_SHIFT).astype(np.int32)
    cv2.polylines(curve, [line], False, 1, 2 * _NEAR_CELLS + 1, cv2.LINE_8, _SHIFT)
    wire = np.minimum(dark, 1.0)
    on_wire = float(np.minimum(along, 1.0).mean())
    on_curve = float((wire * curve).sum() / max(float(wire.sum()), 1e-6))
    tip = float(np.clip((along[0] - 1.0) * WIRE / TIP, 0.0, 1.0))
    return 2.0 * on_wire * on_curve / max(on_wire + on_curve, 1e-6) + _TIP_WEIGHT * tip


def points_in(points: NDArray[np.floating], view: int) -> NDArray[np.floating]:
    """Takes points (..., 2) of the picture, shares of the side, to those of a view: undoes `turned_back`."""
    x, y = points[..., 0], points[..., 1]
    for _ in range(view % _QUARTERS):
        x, y = y, 1.0 - x
    return np.stack([1.0 - x if view >= _QUARTERS else x, y], -1)


@torch.inference_mode()
def best_of_views(network: CurveNetwork, levels: Tensor) -> CurveBatch:
    """Reads pictures of maps (B, 1, s, s) in every view; of each, the curve that agrees best with it is kept.

    A network that can read again does so twice in every view, beginning with the curve that is best so far. What is
    said of the kind of image is the mean of the first readings.
    """
    count, size = len(levels), levels.shape[-1]
    pictures = levels[:, 0].cpu().numpy().astype(np.uint8)
    scores = np.full(count, -1.0)
    points = np.zeros((count, _POINTS, 2))  # of the best curves, px of the picture
    best: CurveBatch | None = None
    kinds = []
    for turn in range(VIEWS * _ROUNDS):
        view = turn % VIEWS
        seen = turned(levels, view)
        if turn < VIEWS:
            reading: CurveBatch | None = network.read(seen)
        else:
            if view == 0:
                begun = points.copy()
            starts = points_in((begun + 0.5) / size, view).astype(np.float32)
            reading = network.read_again(seen, torch.from_numpy(starts).to(levels.device))
        if reading is None:
            break
        if turn < VIEWS:
            kinds.append(reading.kind)
        tokens = reading.tokens.cpu().numpy().astype(float)
        tokens[..., 1:] = turned_back(tokens[..., 1:], view)
        reading = reading._replace(tokens=torch.from_numpy(tokens).to(reading.tokens))
        if best is None:
            best = reading
        better = np.zeros(count, bool)
        for row, picture in enumerate(pictures):
            curve = sampled(tokens_px(tokens[row, : int(reading.lengths[row])], size), _POINTS)
            score = agreement(curve, picture)
            if score > scores[row]:
                scores[row], points[row], better[row] = score, curve, True
        best = _replaced(best, reading, torch.from_numpy(better).to(levels.device))
    assert best is not None
    return best._replace(kind=ImageKind(*(torch.stack(one).mean(0) for one in zip(*kinds, strict=True))))


def _replaced(best: CurveBatch, other: CurveBatch, rows: Tensor) -> CurveBatch:
    """Takes the curves of some rows (B,) from another batch; the features stay."""

    def kept(a: Tensor, b: Tensor) -> Tensor:
        return torch.where(rows.reshape(-1, *[1] * (a.dim() - 1)), b, a)

    error = None if best.error is None or other.error is None else kept(best.error, other.error)
    return best._replace(
        tokens=kept(best.tokens, other.tokens), lengths=kept(best.lengths, other.lengths),
        quality=kept(best.quality, other.quality), error=error,
    )  # fmt: skip
