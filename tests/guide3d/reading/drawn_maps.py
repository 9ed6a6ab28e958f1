"""Probability maps of a drawn wire, as a network would give them: soft lines with gaps, weak parts and false marks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array, arc_length, at_length, distances_to, resample
from guide3d.opencv import cv2
from guide3d.reading.maps import ReaderMaps

Map = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DrawnMaps:
    """Maps (h, w) of 0 to 1 with the wire (n, 2) that they show, tip first."""

    points_px: Array
    wire: Map
    tip: Map


def soft_line(shape: tuple[int, int], points: Array, width_px: float = 5.0) -> Map:
    """Draws a line of probability 1 that is soft at its borders."""
    canvas = np.zeros(shape, np.float32)
    fixed = np.round(np.asarray(points) * 16).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, 1.0, round(width_px), cv2.LINE_AA, shift=4)
    return np.asarray(cv2.GaussianBlur(canvas, (0, 0), 0.8))


def bent(pieces: list[tuple[float, float]], start: tuple[float, float], angle: float) -> Array:
    """Draws a curve of arcs (length px, curvature 1/px) from a point with a direction; (n, 2) px, one a px."""
    curvature = np.concatenate([np.full(round(length), bend) for length, bend in pieces])
    kernel = np.hanning(15) / np.hanning(15).sum()
    heading = angle + np.cumsum(np.convolve(np.pad(curvature, 7, mode="edge"), kernel, "valid"))
    return np.array(start) + np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


def maps_of(
    points: Array,
    size_px: int = 1024,
    gaps: tuple[tuple[float, float], ...] = (),
    weak: tuple[tuple[float, float, float], ...] = (),
    tip: float = 0.9,
) -> DrawnMaps:
    """Draws the maps of a wire (n, 2) px, tip first, with a peak of some height at its tip.

    Gaps are px of arc length from the tip between which nothing is seen; weak parts also have a probability.
    """
    points = resample(points, spacing=1.0)
    leaves = np.flatnonzero(((points < 0) | (points > size_px - 1)).any(axis=1))
    points = points[: leaves[0]] if len(leaves) else points
    shape = (size_px, size_px)
    value = np.ones(len(points), np.float32)
    for first, last in gaps:
        value[round(first) : round(last)] = 0.0
    for first, last, level in weak:
        value[round(first) : round(last)] = level
    wire = np.zeros(shape, np.float32)
    cuts = np.flatnonzero(np.diff(value)) + 1
    for part in np.split(np.arange(len(points)), cuts):
        if value[part[0]] > 0 and len(part) > 1:
            wire = np.maximum(wire, value[part[0]] * soft_line(shape, points[part]))
    blob = np.zeros(shape, np.float32)
    if tip:
        y, x = np.mgrid[:size_px, :size_px]
        blob = (tip * np.exp(-0.5 * ((x - points[0, 0]) ** 2 + (y - points[0, 1]) ** 2) / 16)).astype(np.float32)
    return DrawnMaps(points, np.clip(0.98 * wire, 0, 1), blob)


def clutter(maps: DrawnMaps, seed: int) -> DrawnMaps:
    """Adds twelve false marks, short bits of lines, noise, and four longer wrong pieces to the map of the wire."""
    rng = np.random.default_rng(seed)
    size = maps.wire.shape[0]
    wire = maps.wire.copy()
    for number in range(16):
        length = rng.uniform(8, 30) if number < 12 else rng.uniform(40, 110)
        level = rng.uniform(0.4, 0.95) if number < 12 else rng.uniform(0.4, 0.8)
        line = bent([(length, rng.normal(0, 0.01))], tuple(rng.uniform(60, size - 60, 2)), rng.uniform(0, 6.28))
        wire = np.maximum(wire, np.float32(level) * soft_line(wire.shape, line, rng.uniform(2.5, 6)))
    noise = cv2.GaussianBlur(rng.standard_normal(wire.shape).astype(np.float32), (0, 0), 1.5) * 0.15
    return DrawnMaps(maps.points_px, np.clip(wire + noise * (0.1 + wire), 0, 1), maps.tip)


def within(points: Array, truth: Array, limit_px: float = 4.0) -> float:
    """Share of the true curve that lies within a distance of a read one."""
    return float((distances_to(points, resample(truth, spacing=1.0)) <= limit_px).mean())


def order_error(points: Array, truth: Array) -> float:
    """Mean distance px at equal share of the length: large where the order is wrong."""
    share = np.linspace(0, 1, 100)
    a = at_length(points, share * arc_length(points)[-1])
    b = at_length(truth, share * arc_length(truth)[-1])
    return float(np.hypot(*(a - b).T).mean())


@dataclass(frozen=True, eq=False)
class DarkLineReader:
    """Stands in for a network on drawn images: dark is wire."""

    tip: Map | None = None

    def maps(self, image: NDArray[np.uint8]) -> ReaderMaps:
        """Maps of an image that `picture` drew."""
        wire = np.clip((150.0 - image.astype(np.float32)) / 90.0, 0.0, 1.0)
        if wire.mean() > 0.3:  # a negative: nothing that looks like a wire
            wire = np.zeros_like(wire)
        empty = np.zeros_like(wire)
        return ReaderMaps(wire, empty, empty if self.tip is None else self.tip)


@dataclass(frozen=True, eq=False)
class DrawnReader:
    """Stands in for a network: gives the maps that a picture was drawn from."""

    drawn: list[DrawnMaps]

    def maps(self, image: NDArray[np.uint8]) -> ReaderMaps:
        """Maps of an image that `picture` drew."""
        found = next((maps for maps in self.drawn if np.array_equal(picture(maps), image)), None)
        empty = np.zeros(image.shape, np.float32)
        return ReaderMaps(*((empty,) * 3 if found is None else (found.wire, empty, found.tip)))


def picture(maps: DrawnMaps) -> NDArray[np.uint8]:
    """Draws an image whose dark lines `DarkLineReader` finds again."""
    return np.asarray(np.rint(150.0 - 90.0 * maps.wire), np.uint8)
