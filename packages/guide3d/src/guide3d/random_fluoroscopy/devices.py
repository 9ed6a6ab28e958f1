"""Devices: wires and catheters of random width and darkness, drawn onto a canvas along a course, and their masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.canvas import Canvas, Image, Points
from guide3d.random_fluoroscopy.courses import STEP_PX, beside, normals, smoothed
from guide3d.random_fluoroscopy.phantom_clutter import log_uniform, rectangle, wall_tube
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.random_fluoroscopy.small_marks import disc

Generator = np.random.Generator

_PIECE_TURN = 3.3  # rad: a wire is drawn in pieces that turn less, so that it is darker where it crosses itself
_CATHETER_PX = (6.0, 14.0)
_TIP_SIGMA_PX = 3.0


def wire(
    canvas: Canvas, generator: Generator, course: Points, settings: FluoroscopySettings, width_px: float | None = None
) -> set[str]:
    """Draws a wire along a course (n, 2) px, tip first.

    Args:
        width_px: None: random.

    Returns:
        Names of what is special about it.
    """
    width = width_px or log_uniform(generator, settings.narrowest_px, settings.widest_px)
    darkness = -np.log(generator.uniform(settings.strongest, settings.weakest))
    draw = generator.random(6)
    soft = generator.uniform(0.0, 0.5)
    kinds = set()
    canvas.attenuation += darkness / 255.0 * _crossing_layer(canvas, course, width, soft)
    if draw[0] < 0.3:
        halo = generator.uniform(-0.12, 0.25) * darkness
        canvas.stroke(course, width * generator.uniform(1.8, 3.5), halo, blur_px=1.0)
    if draw[1] < settings.tip_change:
        _change_tip(canvas, generator, course, width, darkness, soft)
        kinds.add("changed tip")
    if draw[2] < settings.beads:
        for place in generator.integers(0, min(len(course), 400), int(generator.integers(1, 6))):
            aside = generator.normal(0, 4, 2) * (generator.random() < 0.5)
            size = generator.uniform(1.0, 2.4) * width + 1
            disc(canvas, course[place] + aside, size, darkness * generator.uniform(0.5, 2))
        kinds.add("beads on the wire")
    if draw[3] < settings.markers:
        _markers(canvas, generator, course, width, darkness)
        kinds.add("markers")
    if draw[4] < 0.1:
        disc(canvas, course[0], width * generator.uniform(1.3, 2.5), darkness * generator.uniform(0.5, 1.5))
    if draw[5] < 0.12:
        _dark_place(canvas, generator, course[0])
        kinds.add("tip on a dark vessel")
    return kinds


def catheter(canvas: Canvas, generator: Generator, course: Points, markers: float) -> float:
    """Draws a catheter along a course (n, 2) px, its end first: hollow, solid or braided; returns its width, px.

    Args:
        markers: chance of radio-opaque bands.
    """
    width, darkness = generator.uniform(*_CATHETER_PX), generator.uniform(0.05, 0.45)
    kind, soft = generator.random(), generator.uniform(0.0, 0.6)
    if kind < 0.55:
        wall = generator.uniform(1.0, 0.32 * width)
        across = normals(course) * (width - wall) / 2
        canvas.stroke(course, width, darkness * generator.uniform(0.2, 0.6), blur_px=soft)
        for side in (-1, 1):
            canvas.stroke(course + side * across, wall, darkness * generator.uniform(0.5, 0.9), blur_px=soft)
    else:
        canvas.stroke(course, width, darkness, blur_px=soft)
        if kind > 0.8:
            gap = int(generator.integers(2, 5))
            near = canvas.inside(course, 20.0)
            across = normals(course) * width / 2
            for place in np.flatnonzero(near)[::gap].tolist():
                bar = np.array([course[place] - across[place], course[place] + across[place]])
                canvas.stroke(bar, 1.5, 0.3 * darkness)
    if generator.random() < markers:
        _markers(canvas, generator, course, width, darkness)
    if generator.random() < 0.4:
        last = min(len(course) - 1, int(generator.uniform(3, 12) / STEP_PX) + 1)
        canvas.stroke(course[: last + 1], width * 0.95, darkness * generator.uniform(0.5, 2.0), blur_px=soft)
    return float(width)


def edge_along(canvas: Canvas, generator: Generator, course: Points) -> None:
    """Draws a tube or a plate whose edge runs along a part of a course (n, 2) px."""
    first = int(generator.uniform(0, 0.5) * min(len(course), 300))
    part = course[first : first + int(generator.uniform(60, 700) / STEP_PX)]
    if len(part) < 12:
        return
    ends = [part[0] + (part[0] - part[6]) * 20, part[-1] + (part[-1] - part[-7]) * 20]
    side = generator.choice((-1.0, 1.0))
    smooth, sway = int(generator.uniform(3, 60)), generator.uniform(0.0, 4.0)
    if generator.random() < 0.65:
        radius = log_uniform(generator, 6, 90)
        middle = beside(generator, part, side * (radius - generator.uniform(0, 5)), sway, smooth)
        wall_tube(
            canvas,
            generator,
            np.vstack((middle[:1] + (ends[0] - part[0]), middle, middle[-1:] + ends[1] - part[-1])),
            radius,
        )
        return
    edge = beside(generator, part, side * generator.uniform(0, 4), sway, smooth)
    far = smoothed(part, 61) + side * normals(smoothed(part, 61)) * generator.uniform(25, 300)
    outline = np.vstack((edge, far[::-1]))
    canvas.polygon(outline, generator.uniform(-0.3, 0.6), blur_px=log_uniform(generator, 0.3, 3.0))


def strip(canvas: Canvas, course: Points, width_px: float) -> NDArray[np.uint8]:
    """The mask (height, width) uint8, 255 along a course, with smooth edges, of constant width."""
    mask = np.zeros((canvas.height, canvas.width), np.uint8)
    layer = canvas.stroke_layer(course, width_px)
    if layer is not None:
        drawn, left, top = layer
        mask[top : top + drawn.shape[0], left : left + drawn.shape[1]] = drawn
    return mask


def tip_blob(canvas: Canvas, tips: Points) -> Image:
    """A Gaussian (height, width), 1 at each tip (n, 2) px of the scene, of a standard deviation of 3 px."""
    blob = np.zeros((canvas.height, canvas.width), np.float32)
    reach = int(4 * _TIP_SIGMA_PX)
    for x, y in canvas.local(tips):
        left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
        columns = np.arange(left, min(int(x) + reach + 1, canvas.width))
        rows = np.arange(top, min(int(y) + reach + 1, canvas.height))
        if not len(columns) or not len(rows):
            continue
        across = np.exp(-0.5 * ((columns - x) / _TIP_SIGMA_PX) ** 2)
        down = np.exp(-0.5 * ((rows - y) / _TIP_SIGMA_PX) ** 2)
        part = blob[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        np.maximum(part, np.outer(down, across).astype(np.float32), out=part)
    return blob


def _crossing_layer(canvas: Canvas, course: Points, width: float, soft: float) -> Image:
    """A stroke, 0 to 255 where it passes once, which adds up where it crosses itself."""
    total = np.zeros((canvas.height, canvas.width), np.float32)
    for number, piece in enumerate(_pieces(course)):
        layer = canvas.stroke_layer(piece, width, soft)
        if layer is None:
            continue
        drawn, left, top = layer
        part = total[top : top + drawn.shape[0], left : left + drawn.shape[1]]
        if number == 0:
            cv2.add(part, drawn, part, dtype=cv2.CV_32F)
            continue
        # two pieces end at the same place with round ends: there, it is one stroke
        x, y = (canvas.local(piece[0]) - (left, top)).tolist()
        reach = width / 2 + 3 * soft + 2
        rows = slice(max(int(y - reach), 0), max(int(y + reach) + 2, 0))
        columns = slice(max(int(x - reach), 0), max(int(x + reach) + 2, 0))
        seam = np.maximum(part[rows, columns], drawn[rows, columns])
        cv2.add(part, drawn, part, dtype=cv2.CV_32F)
        part[rows, columns] = seam
    return total


def _pieces(course: Points) -> list[Points]:
    """A course cut where it has turned far since the last cut."""
    step = np.diff(course, axis=0)
    angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    pieces, start = [], 0
    while start < len(course) - 1:
        far = np.flatnonzero(np.abs(angle[start:] - angle[start]) > _PIECE_TURN / 2)
        end = start + max(int(far[0]), 1) if len(far) else len(course) - 1
        pieces.append(course[start : end + 1])
        start = end
    return pieces


def _change_tip(
    canvas: Canvas, generator: Generator, course: Points, width: float, darkness: float, soft: float
) -> None:
    length = int(generator.uniform(8, 130) / STEP_PX)
    factor = generator.uniform(0.3, 0.85) if generator.random() < 0.5 else generator.uniform(1.2, 2.4)
    wider = generator.uniform(0.9, 1.0) if factor < 1 else generator.uniform(1.0, 1.5)
    for share in (1.0, 0.6):  # in two steps, so that it has no sharp border
        last = max(2, int(share * length))
        canvas.stroke(course[: last + 1], width * wider, 0.5 * (factor - 1) * darkness, blur_px=soft)


def _markers(canvas: Canvas, generator: Generator, course: Points, width: float, darkness: float) -> None:
    count, gap = int(generator.integers(1, 6)), int(generator.uniform(10, 60) / STEP_PX) + 1
    first, size = int(generator.uniform(0, 40) / STEP_PX), max(1, int(generator.uniform(3, 14) / STEP_PX))
    for place in range(first, min(first + count * gap, len(course) - size - 1), gap):
        canvas.stroke(
            course[place : place + size + 1], width * 1.1, darkness * generator.uniform(0.6, 1.8), blur_px=0.3
        )


def _dark_place(canvas: Canvas, generator: Generator, tip: Points) -> None:
    """Something dark over the tip: a filled vessel or a block."""
    darkness, soft = generator.uniform(0.2, 0.9), log_uniform(generator, 0.6, 5)
    turn, size = generator.uniform(0, np.pi), generator.uniform(14, 60)
    place = tip + generator.normal(0, 0.35 * size, 2)
    if generator.random() < 0.5:
        canvas.polygon(rectangle(place, size * generator.uniform(1, 3), size, turn), darkness, blur_px=soft)
        return
    toward = np.array([np.cos(turn), np.sin(turn)]) * generator.uniform(0.3, 4) * size
    canvas.stroke(np.linspace(place - toward, place + toward, 6), size, darkness, blur_px=soft)
