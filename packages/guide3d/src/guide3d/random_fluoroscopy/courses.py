"""Courses: polylines of wires, tubes and vessels in the plane of the image, random or laid from given curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

STEP_PX = 3.0  # of a wire
_STRAIGHT = (1 / 2500, 1 / 70)  # range of the bend of a wire, 1/px
_GIVEN_PX_PER_MM = (2.0, 5.5)
_MARGIN_PX = 40.0  # a course ends where it is so far outside the image


def walk(
    generator: np.random.Generator, start: Points, heading: float, length_px: float, bend: float, knot_px: float,
    step_px: float,
) -> Points:  # fmt: skip
    """A course of smoothly varying curvature.

    Args:
        start: (2,) px; heading: rad.
        bend: standard deviation of the curvature, 1/px.
        knot_px: distance between independent values of the curvature.

    Returns:
        (n, 2) px, `step_px` apart.
    """
    steps = max(2, int(length_px / step_px))
    return _integrated(start, heading, random_curvature(generator, steps, bend, knot_px / step_px), step_px)


def random_curvature(generator: np.random.Generator, steps: int, bend: float, knot_steps: float) -> Points:
    """Curvature (steps,), 1/px, linear between independent normal values."""
    knots = generator.normal(0.0, bend, int(steps / knot_steps) + 2)
    return np.interp(np.arange(steps) / knot_steps, np.arange(len(knots)), knots)


def wire_course(generator: np.random.Generator, side_px: int) -> tuple[Points, set[str]]:
    """A random course of a wire through an image, tip first, that leaves the image at its other end.

    Most are gently bent; some have a loop, a hairpin, or a tip that is bent, angled, curled or folded back over it.

    Returns:
        (n, 2) px, and the names of what is special about it.
    """
    bend = float(np.exp(generator.uniform(np.log(_STRAIGHT[0]), np.log(_STRAIGHT[1]))))
    steps = int(4.0 * side_px / STEP_PX)
    curvature = random_curvature(generator, steps, bend, generator.uniform(40, 300) / STEP_PX)
    kinds = set()
    draw = generator.random(3)
    side = generator.choice((-1.0, 1.0))
    at = 0
    if draw[0] < 0.2:
        at = _turn(curvature, 0, side * generator.uniform(1.2, 3.6), generator.uniform(7, 30))
        kinds.add("bent tip")
    elif draw[0] < 0.3:
        at = _turn(curvature, int(generator.uniform(8, 40) / STEP_PX), side * generator.uniform(0.4, 1.2), 4.0)
        kinds.add("angled tip")
    elif draw[0] < 0.42:
        back = int(generator.uniform(12, 110) / STEP_PX)
        curvature[:back] = curvature[:back] * 0.3
        at = _turn(curvature, back, side * generator.uniform(2.8, 3.4), generator.uniform(2.5, 10))
        kinds.add("folded tip")
    elif draw[0] < 0.48:
        at = _turn(
            curvature, int(generator.uniform(3, 12) / STEP_PX), side * generator.uniform(4, 8), generator.uniform(8, 30)
        )
        kinds.add("curled tip")
    if draw[1] < 0.14:
        place = at + int(generator.uniform(20, 350) / STEP_PX)
        _turn(curvature, place, generator.choice((-1, 1)) * generator.uniform(5.6, 7.6), generator.uniform(14, 110))
        kinds.add("loop")
    elif draw[1] < 0.22:
        place = at + int(generator.uniform(30, 350) / STEP_PX)
        _turn(curvature, place, generator.choice((-1, 1)) * generator.uniform(2.4, 3.6), generator.uniform(10, 45))
        kinds.add("hairpin")
    tip = generator.uniform(0.03, 0.97, 2) * side_px
    points = _integrated(tip, generator.uniform(0, 2 * np.pi), curvature, STEP_PX)
    return leaving(points, side_px), kinds


def given_course(generator: np.random.Generator, curves: Sequence[NDArray[np.floating]], side_px: int) -> Points:
    """One of the given curves, tip first, turned, scaled and moved at random, and drawn out until it leaves the image.

    Args:
        curves: each (n, 2) px of an image, or (n, 3) mm in space, which is seen along a random direction.

    Returns:
        (n, 2) px.
    """
    curve = np.asarray(curves[int(generator.integers(len(curves)))], float)
    turn = generator.uniform(0, 2 * np.pi)
    if curve.shape[1] == 3:
        curve = (curve @ _random_rotation(generator))[:, :2] * generator.uniform(*_GIVEN_PX_PER_MM)
    else:
        curve = curve * generator.uniform(0.7, 1.4) * generator.choice([(1.0, 1.0), (-1.0, 1.0)])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    curve = curve @ rotation.T
    tip = generator.uniform(0.05, 0.95, 2) * side_px
    points = resampled(curve - curve[0] + tip, STEP_PX)
    back = points[-1] - points[-min(len(points), 8)]
    heading = float(np.arctan2(back[1], back[0]))
    rest = walk(generator, points[-1], heading, 2.0 * side_px, 1 / 1500, 120.0, STEP_PX)
    return leaving(np.vstack((points, rest[1:])), side_px)


def drawn_on(generator: np.random.Generator, points: Points) -> Points:
    """A course (n, 2) px that begins 20 to 500 px before the first point of another."""
    step = points[0] - points[min(len(points) - 1, 8)]
    heading, length = float(np.arctan2(step[1], step[0])), generator.uniform(20, 500)
    ahead = walk(generator, points[0], heading, length, 1 / 250, 80.0, STEP_PX)
    return np.vstack((ahead[:0:-1], points))


def leaving(points: Points, side_px: int) -> Points:
    """A course up to where it has left the image for the first time."""
    outside = np.flatnonzero((points < -_MARGIN_PX).any(axis=1) | (points > side_px + _MARGIN_PX).any(axis=1))
    return points[: max(int(outside[0]) + 1, 2)] if len(outside) else points


def resampled(points: Points, step_px: float) -> Points:
    """A polyline (n, 2) at equal distances."""
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    places = np.linspace(0.0, lengths[-1], max(2, int(lengths[-1] / step_px) + 1))
    return np.column_stack([np.interp(places, lengths, axis) for axis in points.T])


def normals(points: Points) -> Points:
    """Unit normals (n, 2) of a polyline."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.hypot(tangent[:, :1], tangent[:, 1:]), 1e-9)
    return np.column_stack((-tangent[:, 1], tangent[:, 0]))


def smoothed(points: Points, window: int) -> Points:
    """A polyline whose points are means over `window` neighbours."""
    window = min(window, len(points)) | 1
    if window < 3:
        return points
    ends = window // 2
    padded = np.pad(points, ((ends + 1, ends), (0, 0)), mode="edge").cumsum(axis=0)
    return (padded[window:] - padded[:-window])[: len(points)] / window


def beside(generator: np.random.Generator, points: Points, offset_px: float, sway_px: float, smooth: int) -> Points:
    """A smoothed course at a distance from another that varies by `sway_px`: a vessel or a wall along a wire."""
    knots = generator.normal(0.0, sway_px, max(3, len(points) // 40))
    sway = np.interp(np.linspace(0, len(knots) - 1, len(points)), np.arange(len(knots)), knots)
    base = smoothed(points, smooth)
    return smoothed(base + normals(base) * (offset_px + sway)[:, None], 15)


def _turn(curvature: Points, start: int, angle: float, radius_px: float) -> int:
    """Puts a bend into a curvature; returns where it ends."""
    steps = max(1, round(abs(angle) * radius_px / STEP_PX))
    end = min(start + steps, len(curvature))
    if end > start:
        curvature[start:end] = angle / (steps * STEP_PX)
    return end


def _integrated(start: Points, heading: float, curvature: Points, step_px: float) -> Points:
    angle = heading + np.cumsum(curvature) * step_px
    steps = step_px * np.column_stack((np.cos(angle), np.sin(angle)))
    return np.asarray(start) + np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))


def _random_rotation(generator: np.random.Generator) -> Points:
    q, r = np.linalg.qr(generator.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.diag(r)))
