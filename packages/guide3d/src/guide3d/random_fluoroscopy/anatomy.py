"""Anatomy: soft tissue, spine, ribs, long bones, gas and vessels of contrast medium, or a CT's projection."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.canvas import Canvas, Points
from guide3d.random_fluoroscopy.courses import normals, resampled, walk
from guide3d.random_fluoroscopy.phantom_clutter import STEP_PX, log_uniform, rectangle, somewhere, wall_tube

Generator = np.random.Generator


WATER_PER_MM = 0.02  # linear attenuation at about 70 keV, 1/mm (NIST, XCOM)
_LEAST_HU = -1000.0
_RANGE = 1.2  # of the attenuations of a background: an exposure shows no more


def tissue(canvas: Canvas, generator: Generator, strength: float) -> None:
    """Slow and fine shades of soft tissue: noise of several scales."""
    for cell, share in ((160, 1.0), (60, 0.5), (20, 0.25), (7, 0.1)):
        rows, columns = canvas.height // cell + 3, canvas.width // cell + 3
        canvas.shade(generator.standard_normal((rows, columns)), strength * share)


def spine(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """Vertebrae in a row: bodies with dark edges and end plates, pedicles, a spinous process, and gaps between."""
    size = generator.uniform(60, 170)
    heading = np.pi / 2 + generator.normal(0, 0.35) + np.pi / 2 * (generator.random() < 0.15)
    start = somewhere(generator, side_px, -0.15) - 0.9 * side_px * np.array([np.cos(heading), np.sin(heading)])
    axis = walk(generator, start, heading, 1.9 * side_px, 1 / 1800, 400, STEP_PX)
    darkness, soft = generator.uniform(0.12, 0.5), generator.uniform(1.0, 4.0)
    wide, high = size * generator.uniform(0.95, 1.4), size * generator.uniform(0.72, 0.88)
    for place in range(4, len(axis) - 4, max(2, round(size / STEP_PX))):
        centre, step = axis[place], axis[place + 3] - axis[place - 3]
        turn = float(np.arctan2(step[1], step[0])) + generator.normal(0, 0.05)
        strength = darkness * generator.uniform(0.8, 1.15)
        wander = generator.normal(0, 0.05 * size, (12, 2))
        if not canvas.inside(centre[None], 1.2 * wide).any():
            continue
        along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        body = rectangle(centre, high, wide, turn)
        body = np.vstack(
            [np.linspace(a, b, 3, endpoint=False) for a, b in zip(body, np.roll(body, -1, 0), strict=True)]
        )
        body[1::3] -= 0.07 * (body[1::3] - centre)  # waisted
        body += 0.3 * wander
        canvas.polygon(body, 0.7 * strength, blur_px=soft)
        canvas.stroke(body, 0.05 * size, 0.3 * strength, blur_px=soft, closed=True)
        for side in (-1.0, 1.0):
            canvas.polygon(_ellipse(centre + side * 0.3 * wide * across, 0.12 * size, 0.1 * size), 0.4 * strength, soft)
        canvas.polygon(_ellipse(centre + 0.25 * high * along, 0.12 * size, 0.22 * size), 0.3 * strength, soft)


def ribs(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """Curved bands with dark edges, one after the other."""
    width, gap = generator.uniform(10, 26), generator.uniform(70, 150)
    heading, bend = generator.uniform(0, 2 * np.pi), generator.choice((-1, 1)) / generator.uniform(250, 900)
    start = somewhere(generator, side_px, 0.3)
    beside = gap * np.array([-np.sin(heading), np.cos(heading)])
    length = generator.uniform(0.5, 1.2) * side_px
    for number in range(-4, 6):
        angle = heading + bend * STEP_PX * np.arange(int(length / STEP_PX)) + generator.normal(0, 0.06)
        course = np.cumsum(STEP_PX * np.column_stack((np.cos(angle), np.sin(angle))), axis=0)
        wall_tube(canvas, generator, start + number * beside + course, width * generator.uniform(0.8, 1.2), 0.25)


def long_bone(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A shaft with thick walls and a wider end: clavicle, humerus, femur, pelvis."""
    heading, length = generator.uniform(0, 2 * np.pi), generator.uniform(0.3, 1.3) * side_px
    course = walk(generator, somewhere(generator, side_px), heading, length, 1 / 900, 250, STEP_PX)
    thickness = generator.uniform(18, 70) * (1 + generator.uniform(0, 0.8) * np.linspace(-1, 1, len(course)) ** 4)
    wall_tube(canvas, generator, course, thickness, 0.4)


def gas(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """Bright blobs of gas: a bowel loop with folds, or a cluster of bubbles."""
    strength, soft = generator.uniform(0.08, 0.55), log_uniform(generator, 1.2, 8)
    start = somewhere(generator, side_px)
    if generator.random() < 0.5:
        course = walk(generator, start, generator.uniform(0, 6.3), generator.uniform(80, 600), 1 / 120, 120, STEP_PX)
        width = generator.uniform(24, 90)
        canvas.stroke(course, width, -strength, blur_px=soft)
        across = normals(course) * width / 2
        for place in range(2, len(course) - 2, max(2, int(width / STEP_PX * 0.6))):
            end = course[place] + across[place] * generator.uniform(-0.3, 0.6)
            canvas.stroke(np.array([course[place] - across[place], end]), 5, 0.4 * strength, blur_px=soft)
        return
    for _ in range(int(generator.integers(2, 14))):
        centre = start + generator.normal(0, 60, 2)
        first, second = generator.uniform(8, 60, 2)
        canvas.polygon(_ellipse(centre, first, second), -strength * generator.uniform(0.4, 1), soft)


def contrast_vessels(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A tree of vessels full of contrast medium: each branch tapers and gives off thinner ones."""
    darkness = log_uniform(generator, 0.08, 1.1)
    soft = generator.uniform(0.6, 2.5)
    start = somewhere(generator, side_px)
    toward = np.array([side_px, side_px]) / 2 + generator.normal(0, 0.2 * side_px, 2) - start
    branches = [(start, float(np.arctan2(toward[1], toward[0])), log_uniform(generator, 10, 90), 0)]
    for _ in range(14):
        if not branches:
            break
        place, heading, width, depth = branches.pop(0)
        length = generator.uniform(0.2, 0.6) * side_px / (1 + 0.5 * depth)
        course = walk(generator, place, heading, length, 1 / (60 + 4 * width), 70, STEP_PX)
        thickness = width * np.linspace(1, generator.uniform(0.5, 0.85), len(course))
        outline = normals(course) * (thickness / 2)[:, None]
        # squared: the path through a round vessel is longest along its axis
        canvas.polygon(np.vstack((course + outline, (course - outline)[::-1])), 0.6 * darkness, soft)
        outline *= 0.6
        canvas.polygon(np.vstack((course + outline, (course - outline)[::-1])), 0.4 * darkness, soft + 0.08 * width)
        children = int(generator.integers(1, 4)) if depth < 3 else 0
        for _ in range(children):
            at = int(generator.uniform(0.2, 0.99) * (len(course) - 1))
            thinner = thickness[at] * generator.uniform(0.35, 0.75)
            if thinner < 6:
                continue
            step = course[min(at + 1, len(course) - 1)] - course[at - 1]
            turn = float(np.arctan2(step[1], step[0])) + generator.choice((-1, 1)) * generator.uniform(0.3, 1.2)
            branches.append((course[at], turn, float(thinner), depth + 1))


def vessel_around(canvas: Canvas, generator: Generator, course: Points, filled: bool) -> None:
    """An empty or filled vessel along a course (n, 2) px, which its own radius follows with slow changes."""
    course = resampled(course, STEP_PX)
    knots = log_uniform(generator, 14, 70) * np.exp(generator.normal(0, 0.18, max(3, len(course) // 18)))
    radius = np.interp(np.linspace(0, len(knots) - 1, len(course)), np.arange(len(knots)), knots)
    if not filled:
        wall_tube(canvas, generator, course, radius, 0.45)
        return
    outline = normals(course) * radius[:, None]
    soft = generator.uniform(0.7, 3.0)
    darkness = log_uniform(generator, 0.08, 0.8)
    canvas.polygon(np.vstack((course + outline, (course - outline)[::-1])), darkness, soft)


def _ellipse(centre: Points, first: float, second: float) -> Points:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return np.asarray(centre + np.column_stack((first * np.cos(angle), second * np.sin(angle))))


ANATOMY = {  # what, and its mean number in a whole image
    "spine": (spine, 0.55),
    "ribs": (ribs, 0.6),
    "bone": (long_bone, 0.8),
    "gas": (gas, 3.0),
}


def projected_ct(
    hounsfield: NDArray[np.floating], spacing_mm: tuple[float, float, float], angle_deg: float
) -> NDArray[np.float32]:
    """Projects a volume (slices, rows, columns) across its first axis.

    Args:
        hounsfield: values of air, -1000, to bone.
        spacing_mm: of slices, rows and columns.
        angle_deg: of the rays about the first axis; 0: along the rows' axis.

    Returns:
        (h, w) attenuation, the slices from top to bottom, one pixel a `spacing_mm` of the columns; the thinnest part is
        0, and the range at most 1.2.

    Raises:
        ValueError: an array that is no volume, or a spacing that is not above 0.
    """
    volume = np.asarray(hounsfield, np.float32)
    if volume.ndim != 3 or min(volume.shape) < 2:
        raise ValueError(f"expected a volume (slices, rows, columns), got an array of shape {volume.shape}")
    if not min(spacing_mm) > 0:
        raise ValueError(f"spacing_mm: expected three numbers above 0, got {spacing_mm}")
    between, down, across = spacing_mm
    rows, columns = round(volume.shape[1] * down / across), volume.shape[2]
    side = int(np.ceil(np.hypot(rows, columns)))
    turn = np.radians(angle_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shift = np.array([side, side]) / 2 - rotation @ np.array([columns, rows]) / 2
    matrix = np.column_stack((rotation, shift))
    lines = np.empty((len(volume), side), np.float32)
    for number, slice_hu in enumerate(volume):
        weight = WATER_PER_MM * np.maximum(slice_hu - _LEAST_HU, 0) / 1000
        weight = cv2.resize(weight, (columns, rows), interpolation=cv2.INTER_LINEAR)
        turned = cv2.warpAffine(weight, matrix, (side, side), flags=cv2.INTER_LINEAR)
        lines[number] = turned.sum(axis=0) * across
    height = max(2, round(len(volume) * between / across))
    image = np.asarray(cv2.resize(lines, (side, height), interpolation=cv2.INTER_CUBIC), np.float32)
    crossed = image.max(axis=0) > 0.2 * image.max()  # the rays beside the body are as good as white
    image = image[:, crossed] if crossed.sum() > 1 else image
    image -= np.percentile(image, 2)
    return np.clip(image * np.float32(min(1.0, _RANGE / max(float(np.percentile(image, 98)), 1e-6))), 0, 2 * _RANGE)
