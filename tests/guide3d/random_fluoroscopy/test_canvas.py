"""Canvas: strokes at their place, sums of attenuations, and windows that show a part of the whole."""

from __future__ import annotations

import numpy as np

from guide3d.random_fluoroscopy.canvas import Canvas

LINE = np.array([[5.0, 20.0], [60.0, 20.0]])


def test_a_stroke_has_its_width_and_attenuation() -> None:
    for width in (1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 12.0):
        canvas = Canvas(0, 0, 64, 48)
        canvas.stroke(LINE, width, 0.5)
        across = canvas.attenuation[:, 30]
        assert width < 2 or abs(across.max() - 0.5) < 0.01
        assert abs(across.sum() / 0.5 - width) < (0.4 if width < 8 else 1.4)
        assert abs((across * np.arange(48)).sum() / across.sum() - 20.0) < 0.1


def test_attenuations_add() -> None:
    canvas = Canvas(0, 0, 64, 48)
    canvas.stroke(LINE, 6.0, 0.5)
    canvas.stroke(LINE, 6.0, 0.25)
    assert abs(canvas.attenuation[20, 30] - 0.75) < 0.01


def test_a_window_shows_a_part_of_the_whole() -> None:
    rng = np.random.default_rng(0)
    points = np.cumsum(rng.normal(0, 9, (40, 2)), axis=0) + 60
    whole, part = Canvas(0, 0, 128, 128), Canvas(40, 32, 48, 64)
    for canvas in (whole, part):
        canvas.stroke(points, 3.0, 0.4)
        canvas.polygon(points[:7], 0.2)
        canvas.text("12 kV", np.array([50.0, 60.0]), 0.6, 1, 0.3)
    np.testing.assert_allclose(part.attenuation, whole.attenuation[32:96, 40:88], atol=0.04)


def test_what_lies_outside_leaves_no_trace() -> None:
    canvas = Canvas(200, 200, 32, 32)
    canvas.stroke(LINE, 6.0, 0.5)
    canvas.polygon(LINE[[0, 1, 1]] + [[0, 0], [0, 0], [0, 9]], 0.5, blur_px=3)
    assert not canvas.attenuation.any()
