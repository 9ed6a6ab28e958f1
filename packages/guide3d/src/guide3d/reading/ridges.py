"""Pieces of a wire in a probability map: the ridges between junctions, with the direction at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.morphology import skeletonize

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2

Map = NDArray[np.float32]

_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
_MARGIN_PX = 2


# How pieces are found.
_LOW = 0.12  # probability from which a pixel may belong to a piece
_HIGH = 0.3  # probability that a piece reaches somewhere
BLUR_PX = 1.0  # standard deviation of the Gaussian that smooths the map first
_SPUR_PX = 7.0  # pieces with a free end that are shorter, at a junction, are dropped
_DIRECTION_PX = 14.0  # length over which the direction of an end is measured
_JUNCTION_PX = 3.0  # pixels nearer to a junction belong to no piece
_WORTH_ABOVE = 0.1  # probability that is worth nothing; a px of a piece is worth what it has more
_PIECES = 48  # most pieces that are kept, the most probable ones


@dataclass(frozen=True, eq=False)
class Pieces:
    """Ridges of a probability map. End 2 k is the first point of piece k, end 2 k + 1 its last.

    points: of each piece (n, 2) px, about one a pixel
    worth: (k,) px, probability above `worth_above` summed along each piece
    ends: (2 k, 2) px
    outward: (2 k, 2) unit vectors that point out of the piece
    joined: (2 k,) whether the end lies at a junction
    """

    points: list[Array]
    worth: Array
    ends: Array
    outward: Array
    joined: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def lengths(self) -> Array:
        """(k,) px."""
        return np.array([float(len(points)) for points in self.points])


def find_pieces(probability: Map, cuts: Array) -> Pieces:
    """Finds the ridges of a probability map.

    Args:
        probability: (h, w) of 0 to 1, smoothed.
        cuts: (n, 2) px where a piece that passes within 4 px is cut in two: a tip may lie on a wire.

    Returns:
        The pieces; none where nothing is probable.
    """
    mask = cv2.threshold(probability, _LOW, 1, cv2.THRESH_BINARY)[1].astype(np.uint8)
    x, y, width, height = cv2.boundingRect(mask)
    if width == 0:
        return _described([], probability)
    box = (slice(y, y + height), slice(x, x + width))
    components = _with_peak(mask[box], probability[box])
    skeleton = np.pad(skeletonize(components), _MARGIN_PX).astype(np.uint8)
    corner = np.array([x - _MARGIN_PX, y - _MARGIN_PX], float)
    traced = _split_at_junctions(skeleton)
    pieces = [(points + corner, joined) for points, joined in traced]
    for place in cuts:
        pieces = [part for piece in pieces for part in _cut(piece, place)]
    return _described(pieces, probability)


def _with_peak(mask: NDArray[np.uint8], probability: Map) -> NDArray[np.bool_]:
    """Keeps the connected parts of a mask that reach a probability somewhere."""
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    strong = np.zeros(count, bool)
    strong[labels[(probability >= _HIGH) & (mask > 0)]] = True
    strong[0] = False
    return np.asarray(strong[labels])


def _split_at_junctions(skeleton: NDArray[np.uint8]) -> list[tuple[Array, tuple[bool, bool]]]:
    """Traces the simple paths that are left when the neighbourhood of every junction is taken out."""
    around = cv2.filter2D(skeleton, -1, _NEIGHBOURS, borderType=cv2.BORDER_CONSTANT)
    junctions = ((skeleton > 0) & (around >= 3)).astype(np.uint8)
    reach = 2 * round(_JUNCTION_PX) + 1
    near = cv2.dilate(junctions, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    near = cv2.max(near, cv2.dilate(junctions, np.ones((3, 3), np.uint8)))
    rows, columns = np.nonzero((skeleton > 0) & (near == 0))
    at_junction = cv2.dilate(near, np.ones((3, 3), np.uint8)) > 0
    pieces = []
    for path in _simple_paths(rows, columns):
        points = path.astype(float)
        first, last = (bool(at_junction[row, column]) for column, row in (path[0], path[-1]))
        free = not (first and last)
        if len(points) < (_SPUR_PX if free and (first or last) else 3):
            continue
        pieces.append((points, (first, last)))
    return pieces


def _simple_paths(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Orders pixels without junctions into paths (n, 2) of x, y; a ring is opened where it is met first."""
    left = set(zip(columns.tolist(), rows.tolist(), strict=True))
    steps = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
    paths = []
    while left:
        start = left.pop()
        halves = []
        for _ in range(2):
            half: list[tuple[int, int]] = []
            pixel: tuple[int, int] | None = start
            while pixel is not None:
                x, y = pixel
                pixel = next((place for dx, dy in steps if (place := (x + dx, y + dy)) in left), None)
                if pixel is not None:
                    left.remove(pixel)
                    half.append(pixel)
            halves.append(half)
        paths.append(np.array([*reversed(halves[0]), start, *halves[1]]))
    return paths


def _cut(piece: tuple[Array, tuple[bool, bool]], place: Array) -> list[tuple[Array, tuple[bool, bool]]]:
    points, (first, last) = piece
    away = np.hypot(*(points - place).T)
    at = int(away.argmin())
    if away[at] > 4.0 or min(at, len(points) - 1 - at) < 8:
        return [piece]
    return [(points[: at + 1], (first, True)), (points[at:], (True, last))]


def _described(pieces: list[tuple[Array, tuple[bool, bool]]], probability: Map) -> Pieces:
    worth = []
    for points, _ in pieces:
        column, row = points.astype(int).T
        worth.append(float((probability[row, column] - _WORTH_ABOVE).sum()))
    order = [k for k in np.argsort(worth)[::-1][:_PIECES] if worth[k] > 0]
    sorted_pieces = [pieces[k] for k in order]
    ends, outward, joined = [], [], []
    for points, both in sorted_pieces:
        for way, at_junction in ((points, both[0]), (points[::-1], both[1])):
            ends.append(way[0])
            outward.append(_outward(way))
            joined.append(at_junction)
    return Pieces(
        [points for points, _ in sorted_pieces],
        np.array([worth[k] for k in order]),
        np.array(ends, float).reshape(-1, 2),
        np.array(outward, float).reshape(-1, 2),
        np.array(joined, bool),
    )


def _outward(points: Array) -> Array:
    """Direction out of a piece at its first point: that of a parabola through its beginning."""
    part = points[: max(4, round(_DIRECTION_PX))]
    s = np.arange(len(part), dtype=float)
    degree = 2 if len(part) >= 10 else 1
    slope = np.polyfit(s, part, degree)[degree - 1]
    size = float(np.hypot(*slope))
    return np.asarray(-slope / size) if size > 1e-6 else np.array([1.0, 0.0])
