"""Courses of vessels: waypoints in order, spread of what is drawn, curves through the knots."""

import numpy as np
import pytest

from cathsim.anatomy.generator.variety_arch import COURSES, Knot, course_curve, draw_course


@pytest.mark.parametrize("name", [name for name, course in COURSES.items() if course[0].heading is not None])
def test_means_of_many_draws_are_those_of_the_waypoints(name):
    rng = np.random.default_rng(1)
    parent = Knot(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.01, 0.0)
    start = np.array([0.01, -0.05, 0.14])
    ends = np.array([draw_course(name, start, rng, parent=parent)[-1].place for _ in range(300)])
    last = COURSES[name][-1]
    offset = np.where([axis in last.fixed for axis in "xyz"], 0.0, start)
    spread = 1e-3 * np.array(last.place_spread_mm)
    assert ends.mean(axis=0) == pytest.approx(offset + 1e-3 * np.array(last.place_mm), abs=4 * spread.max() / 300**0.5)
    assert ends.std(axis=0) == pytest.approx(spread, rel=0.2, abs=1e-9)


def test_a_curve_passes_its_knots_at_even_steps():
    knots = draw_course("aorta", np.zeros(3), np.random.default_rng(2), calibre=0.85)
    points, radius = course_curve(knots)
    for knot in knots:
        nearest = np.argmin(np.linalg.norm(points - knot.place, axis=1))
        assert np.linalg.norm(points[nearest] - knot.place) < 6e-4
        assert 2 * radius[nearest] == pytest.approx(knot.diameter, abs=1e-4)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps == pytest.approx(np.full(len(steps), 1e-3), rel=0.02)
    assert 2 * radius[0] == pytest.approx(0.85 * 17e-3, abs=3 * 0.85e-3)


def test_a_vessel_goes_on_as_the_one_it_continues():
    parent = Knot(np.zeros(3), np.array([-0.3, 0.3, 0.9]), 0.0087, -0.1)
    knots = draw_course("right_subclavian_of_trunk", np.zeros(3), np.random.default_rng(3), parent=parent)
    along = knots[0].velocity / np.linalg.norm(knots[0].velocity)
    assert along == pytest.approx(parent.velocity / np.linalg.norm(parent.velocity))
    assert (knots[0].diameter, knots[0].widening) == (parent.diameter, parent.widening)
