"""Small marks: screws, beads, crosses, dashes, grids, texts and clips, drawn onto a canvas; none of them is a wire."""

from __future__ import annotations

import numpy as np

from guide3d.random_fluoroscopy.canvas import Canvas, Points
from guide3d.random_fluoroscopy.courses import walk
from guide3d.random_fluoroscopy.phantom_clutter import log_uniform, rectangle, somewhere

Generator = np.random.Generator

_LETTERS = "LRAPFH0123456789 kVmAcm:-/.SID"


def screw(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A threaded rod with a head."""
    start, heading = somewhere(generator, side_px, 0.0), generator.uniform(0, 2 * np.pi)
    length, width, pitch = generator.uniform(20, 110), generator.uniform(4, 13), generator.uniform(3, 6)
    along = np.arange(0, length, pitch / 2)
    zigzag = np.where(np.arange(len(along)) % 2, 1.0, -1.0) * width / 2
    local = np.column_stack((along, zigzag))
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    darkness = generator.uniform(0.15, 1.2)
    canvas.stroke(np.array([[0, 0], [length, 0.0]]) @ turn + start, width * 0.8, darkness * 0.6, blur_px=0.6)
    canvas.stroke(local @ turn + start, generator.uniform(1.5, 3), darkness * 0.5, blur_px=0.6)
    canvas.polygon(rectangle(start, width * 0.9, width * 1.9, heading), darkness, blur_px=0.6)


def bead(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """One to a dozen small balls: alone, in a row or scattered."""
    count = int(generator.choice((1, 1, 1, 3, 8, 12)))
    place = somewhere(generator, side_px, 0.0)
    if generator.random() < 0.4:
        steps = np.arange(count)[:, None] * generator.normal(0, 16, 2)
    else:
        steps = generator.normal(0, 60, (count, 2))
    width, darkness = generator.uniform(2, 11), generator.uniform(0.1, 1.0)
    for step in steps:
        disc(canvas, place + step, width, darkness)


def disc(canvas: Canvas, place: Points, width_px: float, darkness: float, blur_px: float = 0.5) -> None:
    """A filled disc."""
    canvas.stroke(np.array([place, place + 0.01]), width_px, darkness, blur_px=blur_px)


def mark(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A short stroke, cross, ring, clip or triangle."""
    place, size = somewhere(generator, side_px, 0.0), generator.uniform(4, 26)
    width, darkness = generator.uniform(1, 5), generator.uniform(-0.3, 0.9)
    angle = generator.uniform(0, 2 * np.pi)
    toward = size / 2 * np.array([np.cos(angle), np.sin(angle)])
    across = toward[::-1] * (-1, 1)
    kind = int(generator.integers(5))
    if kind == 0:
        canvas.stroke(np.array([place - toward, place + toward]), width, darkness, blur_px=0.5)
    elif kind == 1:
        canvas.stroke(np.array([place - toward, place + toward]), width, darkness, blur_px=0.5)
        canvas.stroke(np.array([place - across, place + across]), width, darkness, blur_px=0.5)
    elif kind == 2:
        turns = np.linspace(0, 2 * np.pi, 20, endpoint=False)
        ring = place + size / 2 * np.column_stack((np.cos(turns), np.sin(turns)))
        canvas.stroke(ring, width, darkness, blur_px=0.5, closed=True)
    elif kind == 3:
        clip = np.array([place + toward + 0.4 * across, place - toward, place + toward - 0.4 * across])
        canvas.stroke(clip, min(width, 3), darkness, blur_px=0.5)
    else:
        canvas.polygon(np.array([place + toward, place - toward, place + across]), darkness, blur_px=0.6)


def dashes(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A row of short strokes: a ruler, a marked tape, stitches or a stent's struts."""
    course = walk(
        generator, somewhere(generator, side_px), generator.uniform(0, 6.3), generator.uniform(60, 500), 1 / 900, 150,
        2.0,
    )  # fmt: skip
    gap, size = int(generator.uniform(4, 16)), generator.uniform(3, 14)
    width, darkness = generator.uniform(1, 3), generator.uniform(0.06, 0.6)
    across = generator.random() < 0.5
    half = size / 2 if across else min(size, 0.8 * gap) / 2  # along: shorter than the spaces, or it would be a line
    for place in range(0, len(course) - 2, gap):
        step = course[place + 1] - course[place]
        step = step / max(float(np.hypot(*step)), 1e-9) * half
        step = np.array([-step[1], step[0]]) if across else step
        canvas.stroke(np.array([course[place] - step, course[place] + step]), width, darkness, blur_px=0.4)


def grid(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """A regular net of thin straight lines over a part of the image."""
    pitch, turn = generator.uniform(14, 50), generator.uniform(0, np.pi / 2)
    width, darkness = generator.uniform(1, 2.5), log_uniform(generator, 0.02, 0.15)
    centre, half = somewhere(generator, side_px, 0.0), generator.uniform(0.1, 0.4) * side_px
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    both = generator.random() < 0.8
    for place in np.arange(-half, half, pitch):
        canvas.stroke(centre + np.array([[place, -half], [place, half]]) @ axes, width, darkness, blur_px=0.3)
        if both:
            canvas.stroke(centre + np.array([[-half, place], [half, place]]) @ axes, width, darkness, blur_px=0.3)


def text(canvas: Canvas, generator: Generator, side_px: int) -> None:
    """Letters or digits, dark or bright."""
    words = "".join(generator.choice(list(_LETTERS), int(generator.integers(1, 12))))
    thickness = int(generator.integers(1, 4))
    darkness = generator.uniform(0.15, 1.0) * generator.choice((-1, 1))
    canvas.text(words, somewhere(generator, side_px, 0.0), generator.uniform(0.35, 1.4), thickness, darkness)


SMALL_MARKS = {  # what, and its mean number in a whole image
    "screw": (screw, 1.2),
    "bead": (bead, 3.5),
    "mark": (mark, 4.0),
    "dashes": (dashes, 0.7),
    "grid": (grid, 0.12),
    "text": (text, 0.5),
}
