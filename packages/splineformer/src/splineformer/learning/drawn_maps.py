"""Maps drawn without an image: what a reader would make of random courses, with gaps and false marks, in milliseconds.

A random X-ray image and its reading take a third of a second. Where a wire runs is learnt from many courses, and a map
shows little more than those, so most samples are drawn directly; what readers really get wrong is learnt from the
others, `splineformer.learning.fluoroscopy_samples`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import arc_length
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.courses import walk, wire_course
from splineformer.image_input import shares_of_pixels
from splineformer.learning.augmentation import Points, inside
from splineformer.map_picture import map_picture

SCENE_PX = 1024  # side of the image that a map would be of; lengths below are px of it
_STRIP_PX = 6.0  # width of the strip that a reader marks
_FINER = 2  # a map is drawn at so many times its size, and averaged
_SHIFT = 4  # binary places of a pixel in what is drawn
_EMPTY, _SEVERAL, _FIELD = 0.12, 0.08, 0.6  # shares of maps: without a wire, with two, with the edge of a field
_STEP_PX = 3.0
_STUB, _KEPT_STUBS = 0.25, 0.4  # a course of which less is seen, in sides, and the share of these that is kept

Generator = np.random.Generator


@dataclass(frozen=True, eq=False)
class DrawnMap:
    """A drawn map.

    Attributes:
        picture: (size, size) uint8, as `splineformer.map_picture.map_picture` makes it.
        curve: (n, 2) shares of the side, tip first, of the wire, or of one of two; None where there is none.
        wires: 0, 1 or 2.
    """

    picture: NDArray[np.uint8]
    curve: Points | None
    wires: int


def drawn_map(generator: Generator, size_px: int) -> DrawnMap:
    """Draws a map with a wire, with two, or with none, and with false marks."""
    wire = np.zeros((_FINER * size_px, _FINER * size_px), np.uint8)
    tip = np.zeros((size_px, size_px), np.float32)
    _false_marks(generator, wire, tip)
    draw = generator.random()
    count = 0 if draw < _EMPTY else 2 if draw < _EMPTY + _SEVERAL else 1
    field = _random_field(generator) if generator.random() < _FIELD else None
    curves = [curve for _ in range(count) if (curve := _seen_course(generator, field)) is not None]
    for curve in curves:
        _draw_wire(generator, wire, curve * SCENE_PX - 0.5)
        if generator.random() < 0.85:
            _blob(tip, curve[0], generator.uniform(0.15, 1.0))
    averaged = cv2.resize(wire, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return DrawnMap(map_picture(averaged, 255.0 * tip), curves[0] if curves else None, len(curves))


def _random_field(generator: Generator) -> tuple[Points, float]:
    """Centre and radius of a round field, shares of the side."""
    return 0.5 + generator.normal(0, 0.03, 2), float(generator.uniform(0.4, 0.65))


def _seen_course(generator: Generator, field: tuple[Points, float] | None) -> Points | None:
    """A random course from its tip to where it leaves image or field; None where too little is seen."""
    curve = _course_in(generator, field)
    stub = curve is None or arc_length(curve)[-1] < _STUB
    return _course_in(generator, field) if stub and generator.random() > _KEPT_STUBS else curve


def _course_in(generator: Generator, field: tuple[Points, float] | None) -> Points | None:
    course, _ = wire_course(generator, SCENE_PX)
    points = shares_of_pixels(course, (SCENE_PX, SCENE_PX))
    if field is not None:
        outside = np.linalg.norm(points - field[0], axis=1) > field[1]
        if not outside[0] and outside.any():  # a tip beyond the edge: as if there were no field
            points = points[: int(np.argmax(outside))]
    return inside(points) if len(points) > 1 else None


def _draw_wire(generator: Generator, wire: NDArray[np.uint8], points_px: Points) -> None:
    """Draws the strip of a wire, weaker along some parts, missing along others."""
    level = np.full(len(points_px), generator.uniform(0.8, 1.0))
    if generator.random() < 0.65:
        for _ in range(1 + generator.poisson(1.5)):
            length = int(np.exp(generator.uniform(np.log(4), np.log(200))) / _STEP_PX) + 1
            first = int(generator.integers(0, max(len(level) - 1, 1)))
            # what is near the tip is lost oftener than what is not
            first = int(first * generator.random()) if generator.random() < 0.3 else first
            weak = generator.random() < 0.4
            level[first : first + length] = generator.uniform(0.2, 0.8) if weak else generator.uniform(0.0, 0.2)
    edges = np.flatnonzero(np.diff(level)) + 1
    runs = list(zip(np.r_[0, edges], np.r_[edges, len(level)], strict=True))
    for first, last in sorted(runs, key=lambda run: float(level[run[0]])):  # the strongest is drawn last
        _stroke(wire, points_px[first : last + 1], float(level[first]))


def _stroke(wire: NDArray[np.uint8], points_px: Points, level: float) -> None:
    scale = len(wire) / SCENE_PX
    places = ((points_px + 0.5) * scale - 0.5) * 2**_SHIFT
    width = max(1, round(_STRIP_PX * scale))
    cv2.polylines(wire, [np.rint(places).astype(np.int32)], False, round(255 * level), width, cv2.LINE_AA, _SHIFT)


def _blob(tip: NDArray[np.float32], place: Points, level: float) -> None:
    """Marks a tip at (2,) shares of the side."""
    at = place * len(tip) - 0.5
    low = np.maximum(np.floor(at).astype(int) - 2, 0)
    high = np.minimum(low + 6, len(tip))
    across = np.exp(-0.5 * ((np.arange(low[0], high[0]) - at[0]) / 0.9) ** 2)
    down = np.exp(-0.5 * ((np.arange(low[1], high[1]) - at[1]) / 0.9) ** 2)
    part = tip[low[1] : high[1], low[0] : high[0]]
    np.maximum(part, level * np.outer(down, across).astype(np.float32), out=part)


def _false_marks(generator: Generator, wire: NDArray[np.uint8], tip: NDArray[np.float32]) -> None:
    """What readers take for wires: short rods with ends like tips, pieces of edges, rings, weak long lines."""
    amount = 2.0 * generator.random()
    for _ in range(generator.poisson(0.5 * amount)):
        points = _anywhere(generator, generator.uniform(500, 1500), 1 / 300)
        _stroke(wire, points, generator.uniform(0.03, 0.2))
    for _ in range(generator.poisson(0.8 * amount)):
        points = _anywhere(generator, generator.uniform(60, 900), 1 / 200)
        at, on, off = 0, generator.uniform(2, 12), generator.uniform(3, 25)
        while at < len(points):
            length = 1 + int(generator.exponential(on))
            _stroke(wire, points[at : at + length + 1], generator.uniform(0.1, 0.9))
            at += length + 1 + int(generator.exponential(off))
    for _ in range(generator.poisson(1.5 * amount)):
        points = _anywhere(generator, generator.uniform(8, 70), 1 / 400)
        _stroke(wire, points, generator.uniform(0.3, 1.0))
        for end in (points[0], points[-1]):
            if generator.random() < 0.5:
                _blob(tip, shares_of_pixels(end, (SCENE_PX, SCENE_PX)).clip(0, 1), generator.uniform(0.2, 1.0))
    for _ in range(generator.poisson(0.25 * amount)):
        angle = np.linspace(0, generator.uniform(2, 2 * np.pi), 40)
        ring = generator.uniform(5, 70) * np.column_stack((np.cos(angle), np.sin(angle)))
        _stroke(wire, generator.uniform(0, SCENE_PX, 2) + ring, generator.uniform(0.2, 0.9))
    for _ in range(generator.poisson(0.5 * amount)):
        _blob(tip, generator.random(2), generator.uniform(0.1, 0.8))


def _anywhere(generator: Generator, length_px: float, bend: float) -> Points:
    start, heading = generator.uniform(0, SCENE_PX, 2), generator.uniform(0, 2 * np.pi)
    return walk(generator, start, heading, length_px, bend, 80.0, _STEP_PX)
