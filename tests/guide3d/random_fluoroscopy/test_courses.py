"""Courses: equal steps, tips inside, ends outside, and given curves that keep their shape."""

from __future__ import annotations

import numpy as np

from guide3d.random_fluoroscopy.courses import STEP_PX, beside, given_course, resampled, walk, wire_course

SIDE = 1024


def test_a_walk_has_equal_steps_and_its_bend() -> None:
    points = walk(np.random.default_rng(0), np.array([10.0, 20.0]), 0.0, 600.0, 1 / 100, 60.0, 2.0)
    steps = np.diff(points, axis=0)
    np.testing.assert_allclose(np.hypot(*steps.T), 2.0, atol=1e-9)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    assert 0.2 / 100 < np.std(turns) / 2.0 < 3 / 100


def test_wires_start_inside_and_leave_the_image() -> None:
    rng = np.random.default_rng(1)
    left = 0
    for _ in range(40):
        course, _ = wire_course(rng, SIDE)
        assert (course[0] > 0).all()
        assert (course[0] < SIDE).all()
        np.testing.assert_allclose(np.hypot(*np.diff(course, axis=0).T), STEP_PX, atol=1e-9)
        left += bool((course[-1] < 0).any() or (course[-1] > SIDE).any())
    assert left > 30


def test_given_curves_keep_their_shape() -> None:
    angle = np.linspace(0, 2.0, 60)
    arc = 200 * np.column_stack((np.cos(angle), np.sin(angle)))
    course = given_course(np.random.default_rng(2), [arc], SIDE)
    steps = np.diff(course[:40], axis=0)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    radius = STEP_PX / np.abs(np.mean(turns))
    assert 0.65 * 200 < radius < 1.45 * 200


def test_beside_keeps_its_distance() -> None:
    line = resampled(np.array([[0.0, 0.0], [600.0, 0.0]]), 3.0)
    other = beside(np.random.default_rng(0), line, 12.0, 0.0, 9)
    np.testing.assert_allclose(other[20:-20, 1], 12.0, atol=1e-6)
