"""Clutter of phantoms: tubes with two walls, shells, plates, rods, fields and ghosts, drawn onto a canvas.

Every function draws one thing of random shape, place and darkness. Tubes are dark at both walls, as a hollow cylinder
is: these walls are thin dark lines too, and what a network must tell from a wire.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from guide3d.random_fluoroscopy.canvas import Canvas, Points
from guide3d.random_fluoroscopy.courses import normals, walk

Generator = np.random.Generator

STEP_PX = 8.0
_WIDEST_LINE_PX = 6.0
_THINNEST_WALL_PX = 2.5  # a thinner wall, from which the inside does not differ, would be a wire along an edge
_SMALLEST_TUBE_PX, _LARGEST_TUBE_PX = 5.0, 45.0  # radius


def log_uniform(generator: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


def somewhere(generator: Generator, side_px: int, margin: float = 0.1) -> Points:
    """A place (2,) px in an image or at most `margin` of its side outside."""
    return np.asarray(generator.uniform(-margin, 1 + margin, 2) * side_px)


def clutter_course(generator: Generator, side_px: int) -> Points:
    """A course (n, 2) px through the image, from straight to winding."""
    bend = log_uniform(generator, 1 / 5000, 1 / 110)
    heading, length = generator.uniform(0, 2 * np.pi), generator.uniform(0.15, 1.4) * side_px
    return walk(generator, somewhere(generator, side_px), heading, length, bend, generator.uniform(60, 400), STEP_PX)


def tube(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A tube, or a vessel of changing width, along a course of its own."""
    course = clutter_course(generator, side_px)
    if generator.random() < 0.7:
        wall_tube(canvas, generator, course, log_uniform(generator, _SMALLEST_TUBE_PX, _LARGEST_TUBE_PX))
        return
    knots = log_uniform(generator, 10, 80) * np.exp(generator.normal(0, 0.2, max(3, len(course) // 12)))
    wall_tube(
        canvas, generator, course, np.interp(np.linspace(0, 1, len(course)), np.linspace(0, 1, len(knots)), knots)
    )


def wall_tube(canvas: Canvas, generator: Generator, course: Points, radius: Any, darkest: float = 0.7) -> None:
    """A tube of two walls along a course (n, 2) px.

    Args:
        radius: px, a number or (n,) along the course.
        darkest: largest absorption of the walls.
    """
    widest = float(np.max(radius))
    darkness = -np.log(1 - log_uniform(generator, 0.04, darkest))
    wall = min(log_uniform(generator, _THINNEST_WALL_PX, 10.0), widest)
    soft = wall * generator.uniform(0.15, 0.5)
    share = generator.uniform(0.2, 0.8)  # of the walls' attenuation that the tube has in its middle
    both, inner = generator.uniform(0.5, 1.0, 2), generator.uniform(0.3, 0.7)
    if not canvas.inside(course, widest + 20).any():
        return
    if np.ndim(radius) == 0:
        canvas.stroke(course, 2 * widest, darkness * share, blur_px=soft)
    else:
        outline = normals(course) * (np.asarray(radius) + wall / 2)[:, None]
        canvas.polygon(np.vstack((course + outline, (course - outline)[::-1])), darkness * share, blur_px=soft)
    # the path through a wall is longest at its inner side and falls off slowly inwards, at once outwards
    across, skirt = normals(course), min(3 * wall, widest)
    for side, strength in zip((1, -1), darkness * both * (1 - share), strict=True):
        offset = side * across * np.asarray(radius - wall / 2).reshape(-1, 1)
        canvas.stroke(course + offset, wall, strength * (1 - inner), blur_px=soft)
        offset = side * across * np.asarray(radius - skirt / 2).reshape(-1, 1)
        canvas.stroke(course + offset, skirt, strength * inner, blur_px=soft + 0.2 * wall)


def shell(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A closed curve with a wall, such as a vessel's cross-section or a bag."""
    centre, size = somewhere(generator, side_px), log_uniform(generator, 15, 0.35 * side_px)
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    order = np.arange(1, 4)[:, None]
    wave = (generator.normal(0, 0.12 / order) * np.cos(order * angle + generator.uniform(0, 6.3, (3, 1)))).sum(axis=0)
    squeeze, turn = generator.uniform(0.4, 1.0), generator.uniform(0, np.pi)
    shape = np.column_stack((np.cos(angle), squeeze * np.sin(angle))) * (size * (1 + wave))[:, None]
    points = centre + shape @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    darkness = -np.log(1 - log_uniform(generator, 0.03, 0.5))
    wall = log_uniform(generator, _WIDEST_LINE_PX, 18.0)  # thinner, it would be a wire along the edge of a plate
    soft = log_uniform(generator, 1.0, 6.0)
    if generator.random() < 0.7:
        canvas.polygon(points, darkness * generator.uniform(0.3, 0.8), blur_px=soft)
    canvas.stroke(points, wall, darkness * 0.6, blur_px=soft, closed=True)


def plate(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A plate or bar with straight edges, sharp or soft, darker along some of them."""
    corners = rectangle(
        somewhere(generator, side_px),
        log_uniform(generator, 20, 0.9 * side_px),
        log_uniform(generator, 12, 0.4 * side_px),
        generator.uniform(0, np.pi),
    ) + generator.normal(0, 0.02 * side_px, (4, 2)) * (generator.random() < 0.4)
    darkness = -np.log(1 - log_uniform(generator, 0.03, 0.5))
    soft = log_uniform(generator, 0.2, 10.0)
    edge = generator.random()
    canvas.polygon(corners, darkness, blur_px=soft)
    if edge < 0.4:
        width = log_uniform(generator, 4, 12)
        canvas.stroke(corners, width, darkness * generator.uniform(-0.5, 0.7), blur_px=soft, closed=True)


def rod(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A straight solid rod, darkest along its axis."""
    start, heading = somewhere(generator, side_px), generator.uniform(0, 2 * np.pi)
    end = start + generator.uniform(0.05, 1.2) * side_px * np.array([np.cos(heading), np.sin(heading)])
    width = log_uniform(generator, 7, 80)
    darkness = -np.log(1 - log_uniform(generator, 0.05, 0.6))
    course = np.linspace(start, end, 12)
    for share, part in ((1.0, 0.45), (0.8, 0.3), (0.5, 0.25)):
        canvas.stroke(course, share * width, darkness * part, blur_px=0.08 * width)


def shading_field(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A wide step of brightness with a soft edge: a table's end, another thickness."""
    place, turn = somewhere(generator, side_px, -0.1), generator.uniform(0, np.pi)
    corners = rectangle(place + side_px * np.array([np.cos(turn), np.sin(turn)]), 2 * side_px, 4 * side_px, turn)
    canvas.polygon(corners, generator.uniform(-0.35, 0.35), blur_px=log_uniform(generator, 0.7, 40))


def ghost(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A bright place: air, a hole, or the trace of an earlier image."""
    course = clutter_course(generator, side_px)
    course = course[: max(2, int(len(course) * generator.uniform(0.02, 0.4)))]
    width, soft = log_uniform(generator, 3, 70), log_uniform(generator, 0.7, 14)
    canvas.stroke(course, width, -generator.uniform(0.03, 0.6), blur_px=soft)


def rectangle(centre: Points, length: float, width: float, turn: float) -> Points:
    """The corners (4, 2) of a turned rectangle."""
    half = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    return np.asarray(centre + half @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))


PHANTOM_CLUTTER = {  # what, and its mean number in a whole image
    "tube": (tube, 16.0),
    "shell": (shell, 3.0),
    "plate": (plate, 5.0),
    "rod": (rod, 2.0),
    "field": (shading_field, 1.0),
    "ghost": (ghost, 3.0),
}
