"""The wire in probability maps: an ordered curve, tip first, through gaps and crossings, with its alternatives.

The ridges of the map are cut into pieces at junctions. A path over the pieces gathers their probability and pays for
every gap, turn, and end: a tip away from the tip map, a proximal end that is neither at the border nor in a catheter.
The best paths are candidates, because one view alone may not decide which end of a knot is the tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array, arc_length, distances_to
from guide3d.opencv import cv2
from guide3d.reading.links import Link, link_costs
from guide3d.reading.path_drawing import centre_line, path_line, to_border, to_tip
from guide3d.reading.path_search import CANDIDATES, GUESSED, TWICE_PX, Path, search
from guide3d.reading.ridges import BLUR_PX, Map, Pieces, find_pieces

_COARSE = 8  # distances from the border are measured on a map this much smaller
_LEAVING_PX = 8.0
UNSURE = 0.5  # confidence below which a point counts as guessed
_TIPS = 6  # peaks of the tip map that are tried


# How a curve is read from maps; costs are px of certain wire.
_TIP_COST = 60.0  # of a tip where the tip map shows none
_TIP_REACH_PX = 14.0  # how far from a peak of the tip map an end may lie
_TIP_LEAST = 0.1  # least peak of the tip map
_BORDER_TIP = 60.0  # cost of a tip at the border
_LOOSE_END = 50.0  # cost of a proximal end inside the field
_BORDER_LINK = 150.0  # cost of going on from an end that leaves the image
_TIP_LINK = 20.0  # cost of going on from an end at a peak of the tip map
_BORDER_PX = 20.0  # an end nearer to the border leaves the field
_LEAST_PX = 35.0  # probability, summed along a path, below which there is no wire
_SECOND_PX = 60.0  # and below which there is no further wire
_PRIOR_PX = 40.0  # how far a wire moves from one image to the next


@dataclass(frozen=True, eq=False)
class ImageCurve:
    """A wire in an image.

    points_px: (n, 2) of the image, tip first, about every 2 px
    confidence: (n,) probability of the wire at each point, 0 to 1; low in gaps
    sd_px: (n,) standard deviation of each point across the curve
    score: px of certain wire, less what its gaps, turns and ends cost
    tip_confidence: height of the tip map at the first point
    """

    points_px: Array
    confidence: Array
    sd_px: Array
    score: float
    tip_confidence: float

    @property
    def length_px(self) -> float:
        """Length."""
        return float(arc_length(self.points_px)[-1])

    @property
    def guessed(self) -> float:
        """Share of the points that are guessed: in gaps, where the wire is faint, or on the way to the border."""
        return float((self.confidence < UNSURE).mean())


@dataclass(frozen=True, eq=False)
class CurvesOfImage:
    """What an image shows.

    candidates: readings of the wire, best first; none: there is no wire
    others: further wires, the best reading of each
    """

    candidates: list[ImageCurve]
    others: list[ImageCurve]


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the wire before the image is read: where it was in the image before.

    points_px: (n, 2) tip first
    """

    points_px: Array


@dataclass(frozen=True, eq=False)
class _Scene:
    """What curves are made from: the smoothed map of wires, peaks of the tip map with their heights, and distance
    from the border on a coarse map."""

    pieces: Pieces
    smooth: Map
    tips: tuple[Array, Array]
    away: Map


def read_curves(
    wire: Map,
    tip: Map | None = None,
    catheter: Map | None = None,
    outside: NDArray[np.bool_] | None = None,
    prior: Prior | None = None,
) -> CurvesOfImage:
    """Reads the wires in probability maps of one image.

    Args:
        wire: (h, w) of 0 to 1, probability of a wire.
        tip: (h, w) of 0 to 1, a blob at the tip; None: the tip is the end inside the field.
        catheter: (h, w) of 0 to 1: a wire may end in it.
        outside: (h, w), pixels that were not exposed; None: the field is the image.
        prior: the wire a moment before.

    Raises:
        ValueError: the maps differ in shape.
    """
    for name, other in (("tip", tip), ("catheter", catheter), ("outside", outside)):
        if other is not None and other.shape != wire.shape:
            raise ValueError(f"expected maps of one shape, got {wire.shape} of the wire and {other.shape} of {name}")
    smooth: Map = cv2.GaussianBlur(np.asarray(wire, np.float32), (0, 0), BLUR_PX).astype(np.float32)
    places, heights = _peaks(tip)
    pieces = find_pieces(smooth, places)
    away = _from_border(wire.shape, outside)
    inside = _inside(pieces, away)
    tipness = _tipness(pieces, places, heights)
    start = _BORDER_TIP * (1.0 - inside) + _TIP_COST * (1.0 - tipness)
    stop = _LOOSE_END * inside * (1.0 - _at(catheter, pieces.ends))
    toll = np.where(pieces.joined, 0.0, _BORDER_LINK * _leaving(pieces, wire.shape) + _TIP_LINK * tipness)
    worth = pieces.worth
    if prior is not None and len(pieces):
        worth, start = _with_prior(pieces, start, prior)
    links = link_costs(pieces, smooth, toll)
    scene = _Scene(pieces, smooth, (places, heights), away)
    paths = _paths(pieces, worth, links, start, stop)
    if not paths or worth[list(paths[0].pieces)].sum() < _LEAST_PX:
        return CurvesOfImage([], [])
    candidates: list[ImageCurve] = []
    for path in _varied(paths, pieces):
        curve = _curve(scene, path)
        if all(_differ(curve, other) for other in candidates):
            candidates.append(curve)
        if len(candidates) == CANDIDATES:
            break
    candidates.sort(key=lambda curve: -curve.score)
    candidates = [curve for curve in candidates if curve.guessed <= GUESSED] or candidates
    return CurvesOfImage(candidates, _others(scene, worth, links, (start, stop), paths[0]))


def _paths(
    pieces: Pieces,
    worth: Array,
    links: list[list[Link]],
    start: Array,
    stop: Array,
) -> list[Path]:
    joined = pieces.joined.reshape(-1, 2)
    shared = joined.any(axis=1) & (pieces.lengths <= TWICE_PX)
    return search(worth, pieces.lengths, links, start, stop, shared)


def _varied(paths: list[Path], pieces: Pieces) -> list[Path]:
    """Orders paths so that those from other tips come early: variations of one path are many and tell little."""
    fresh: list[Path] = []
    again: list[Path] = []
    for path in paths:
        tip = pieces.ends[path.entries[0]]
        known = [pieces.ends[other.entries[0]] for other in fresh]
        near = any(np.hypot(*(tip - place)) < _TIP_REACH_PX for place in known)
        (again if near else fresh).append(path)
    ordered = [fresh[0], *again[:1], *fresh[1:3], *again[1:], *fresh[3:]]
    return [path for path in ordered if path.score > 0.3 * paths[0].score]


def _others(
    scene: _Scene,
    worth: Array,
    links: list[list[Link]],
    costs: tuple[Array, Array],
    best: Path,
) -> list[ImageCurve]:
    """Reads what is left when the pieces of a path are taken out, as long as that is a wire."""
    used = set(best.pieces)
    others: list[ImageCurve] = []
    while len(others) < 3:
        free = [[link for link in onward if link.end // 2 not in used] for onward in links]
        start = costs[0].copy()
        start[[end for piece in used for end in (2 * piece, 2 * piece + 1)]] = np.inf
        paths = _paths(scene.pieces, worth, free, start, costs[1])
        if not paths or not np.isfinite(paths[0].score):
            break
        if worth[list(paths[0].pieces)].sum() < _SECOND_PX:
            break
        others.append(_curve(scene, paths[0]))
        used |= paths[0].pieces
    return others


def _peaks(tip: Map | None) -> tuple[Array, Array]:
    """Peaks of the tip map (n, 2) px, below the pixel, and their heights (n,), highest first."""
    if tip is None or float(tip.max()) < _TIP_LEAST:
        return np.empty((0, 2)), np.empty(0)
    tip = np.asarray(tip, np.float32)
    highest = cv2.dilate(tip, np.ones((15, 15), np.uint8))
    rows, columns = np.nonzero((tip >= highest) & (tip >= _TIP_LEAST))
    order = np.argsort(tip[rows, columns])[::-1][:_TIPS]
    places: list[Array] = []
    heights: list[float] = []
    for row, column in zip(rows[order], columns[order], strict=True):
        top, left = max(row - 5, 0), max(column - 5, 0)
        window = tip[top : row + 6, left : column + 6] ** 2
        y, x = np.mgrid[: window.shape[0], : window.shape[1]]
        place = np.array([(window * x).sum(), (window * y).sum()]) / window.sum() + [left, top]
        if all(np.hypot(*(place - other)) > 8.0 for other in places):
            places.append(place)
            heights.append(float(tip[row, column]))
    return np.array(places), np.array(heights)


def _from_border(shape: tuple[int, ...], outside: NDArray[np.bool_] | None) -> Map:
    """Distance px from the border of the field, on a map that is `_COARSE` times smaller."""
    height, width = (-(-side // _COARSE) for side in shape)
    exposed = np.ones(shape, np.uint8) if outside is None else (~outside).astype(np.uint8)
    coarse = cv2.resize(exposed, (width, height), interpolation=cv2.INTER_NEAREST)
    away = cv2.distanceTransform(np.pad(coarse, 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    return np.asarray((away - 0.5) * _COARSE, np.float32)


def _inside(pieces: Pieces, away: Map) -> Array:
    """Tells (2 k,) of each end how far it is inside the field, from 0 at its border to 1."""
    column, row = (pieces.ends / _COARSE).astype(int).T
    return np.asarray(np.clip(away[row, column] / _BORDER_PX - 1.0, 0.0, 1.0))


def _leaving(pieces: Pieces, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tells (2 k,) of each end whether a few px more would lead out of the image."""
    ahead = pieces.ends + _LEAVING_PX * pieces.outward
    return np.asarray(((ahead < 0) | (ahead > np.array([shape[1], shape[0]]) - 1)).any(axis=1))


def _tipness(pieces: Pieces, places: Array, heights: Array) -> Array:
    """Height (2 k,) of the tip map's peaks as each end sees them, at itself or a little ahead."""
    best = np.zeros(len(pieces.ends))
    if not len(places) or not len(pieces):
        return best
    # the soft end of a tip may be in the tip map and not in the wire's
    for sample in (pieces.ends, pieces.ends + 0.5 * _TIP_REACH_PX * pieces.outward):
        apart = np.hypot(*(sample[:, None] - places[None]).transpose(2, 0, 1))
        best = np.maximum(best, (heights * np.exp(-0.5 * (apart / _TIP_REACH_PX) ** 2)).max(axis=1))
    return best


def _at(values: Map | None, ends: Array) -> Array:
    """Largest value (2 k,) of a map within 4 px of each end."""
    if values is None:
        return np.zeros(len(ends))
    around = cv2.dilate(np.asarray(values, np.float32), np.ones((9, 9), np.uint8))
    column, row = ends.astype(int).T
    return np.asarray(around[row, column], float)


def _with_prior(pieces: Pieces, start: Array, prior: Prior) -> tuple[Array, Array]:
    """Makes pieces near the wire of a moment before worth more, and tips near its tip cheaper."""
    near = [
        np.exp(-0.5 * (distances_to(prior.points_px, points[::4]) / _PRIOR_PX) ** 2).mean() for points in pieces.points
    ]
    worth = pieces.worth * (0.5 + 0.5 * np.array(near))
    away = np.hypot(*(pieces.ends - prior.points_px[0]).T)
    close = np.exp(-0.5 * (away / _PRIOR_PX) ** 2)
    return worth, start - 0.5 * _TIP_COST * close


def _curve(scene: _Scene, path: Path) -> ImageCurve:
    line, height = to_tip(path_line(scene.pieces, path), *scene.tips, _TIP_REACH_PX)
    line = to_border(line, scene.smooth, scene.away, _COARSE)
    points, confidence, deviation = centre_line(line, scene.smooth)
    return ImageCurve(points, confidence, deviation, path.score, height)


def _differ(curve: ImageCurve, other: ImageCurve) -> bool:
    """Whether two readings differ by more than a few px: in tip, length or course."""
    if np.hypot(*(curve.points_px[0] - other.points_px[0])) > 8.0:
        return True
    if abs(curve.length_px - other.length_px) > 12.0:
        return True
    count = min(len(curve.points_px), len(other.points_px))
    return float(np.hypot(*(curve.points_px[:count] - other.points_px[:count]).T).max()) > 12.0
