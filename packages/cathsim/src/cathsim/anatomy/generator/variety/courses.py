"""Courses of the vessels of the arch variety: published waypoints, and curves drawn through them.

Source: the waypoints, means and standard deviations are those of the aortic arch generator of L. Karstensen et al.,
"Recurrent neural networks for generalization towards the vessel geometry in autonomous endovascular guidewire
navigation in the aortic arch", IJCARS 2023, doi 10.1007/s11548-023-02938-7 (github.com/lkarstensen, repositories
2023_IJCARS_aortic_arch_generator and stEVE, MIT licence); lengths there are millimetres, axes x to the patient's left,
y to the back and z up, with the origin in the descending aorta.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.branching import STEP

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Spread = tuple[float, float]  # mean and standard deviation

MM = 1e-3
_SAMPLE = 2e-4  # m of chord between the samples of a curve
_LEAST_DIAMETER = 4.0  # mm
_NONE = (0.0, 0.0, 0.0)


class Waypoint(NamedTuple):
    """What is drawn, by normal distributions, for a place that a vessel passes."""

    place_mm: Triple  # from the vessel's start; on the axes of `fixed` from the origin
    place_spread_mm: Triple
    heading: Triple | None  # direction, of any length; None: as the parent heads at its end
    heading_spread: Triple
    swing: Spread  # length of the curve's derivative by the chord: above 1 the curve swings out
    diameter_mm: Spread | None  # of a first waypoint; the others' is a change. None: the parent's at its end
    widening: Spread = (0.0, 0.0)  # derivative of the diameter by the chord
    fixed: str = ""  # axes, of "xyz"


class Knot(NamedTuple):
    """A drawn waypoint."""

    place: Array  # (3,) m
    velocity: Array  # (3,) derivative of the place by the chord
    diameter: float  # m
    widening: float  # derivative of the diameter by the chord


def _start(heading: Triple | None, spread: Triple, swing: Spread, diameter: Spread | None) -> Waypoint:
    return Waypoint(_NONE, _NONE, heading, spread, swing, diameter)


_AORTA = (
    Waypoint(_NONE, _NONE, (0, 0, 1), (0.1, 0, 0.3), (1.0, 0.1), (17, 1), (0.02, 0.005)),
    Waypoint((30, 0, 90), (2, 1, 3), (1, 0, 2), (0.4, 0.3, 0.2), (1.2, 0.15), (3, 0.7), (0.02, 0.005)),
    Waypoint((20, -40, 160), (1.5, 3, 2), (-4, -6, -0.5), (0.8, 1, 0.7), (1.4, 0.15), (4, 0.7), (0.07, 0.008)),
    Waypoint((-5, -60, 100), (1, 2, 1), (3, 4, -8), (0.3, 0.3, 0.5), (1.6, 0.15), (5, 0.7)),
)
_TRUNK_START = _start((0, 0.1, 1), (0.1, 0.1, 0), (2.0, 0.1), (17, 1))
_WIDE_TRUNK_START = _start((0, 0.6, 1), (0.2, 0.2, 0.3), (1.0, 0.1), (22, 1))
_CAROTID, _ARM = (1.5, 0.2), (2.0, 0.4)  # swings
_THIN: Spread = (10, 0.33)
_UP = (0.0, 0.0, 1.0)
_LEFT_ARM = _start((0.1, 0.1, 2), (0.1, 0.1, 0.3), _ARM, _THIN)


def _carotid_end(place: Triple, spread: Triple, heading: Triple, heading_spread: Triple, change: Spread) -> Waypoint:
    return Waypoint(place, spread, heading, heading_spread, _CAROTID, change, fixed="z")


def _left_arm_end(y: float, z: float, heading: Triple) -> Waypoint:
    spread = (0.2, 0.07, 0.15)
    return Waypoint((59, y, z), (0, 2, 2), heading, spread, (1.7, 0.4), (-1, 0.33), (-0.1, 0.03), "x")


def _right_arm_end(y: float, z: float, heading: Triple, spread: Triple = (0.3, 0.2, 0.1)) -> Waypoint:
    return Waypoint((-57, y, z), (0, 2, 1), heading, spread, _CAROTID, (0, 0), fixed="x")


_FORK_RIGHT_ARM = _start(None, _NONE, _CAROTID, None)
_OWN_RIGHT_ARM = _start((0.1, 0.1, 2), (0.1, 0.1, 0.3), _ARM, _THIN)
_RIGHT_CAROTID_END = _carotid_end((0, 0, 230), (2, 2, 0), _UP, (0.1, 0.1, 0), (-1, 0.33))

# by name; of every vessel the waypoints from its start on the parent's centreline to its end
COURSES: dict[str, tuple[Waypoint, ...]] = {
    "aorta": _AORTA,
    "trunk": (
        _TRUNK_START,
        Waypoint((-20, 5, 45), (3, 2, 3), (-0.3, 0.3, 0.7), (0.1, 0.1, 0.3), (0.8, 0.1), (-7, 0.7), (-0.1, 0.033)),
    ),
    "wide_trunk": (
        _WIDE_TRUNK_START,
        Waypoint((5, 5, 25), (1.5, 1.5, 3), (-0.3, 0.3, 0.7), (0.3, 0.2, 0.3), (0.8, 0.1), (-10, 0.7), (-0.1, 0.033)),
    ),
    "left_carotid": (
        _start((0.3, 0, 1), (0.2, 0.2, 0), _CAROTID, _THIN),
        _carotid_end((2, 8, 230), (1, 3, 0), _UP, (0.2, 0.3, 0), (-0.5, 0.2)),
    ),
    "left_carotid_of_trunk": (
        _start((0.6, 0, 1), (0.2, 0.3, 0.3), _CAROTID, _THIN),
        _carotid_end((25, 8, 230), (1, 3, 0), _UP, (0.2, 0.3, 0), (-0.5, 0.2)),
    ),
    "right_carotid_of_trunk": (_start((0.2, 0, 1), (0.2, 0.2, 0.3), _CAROTID, _THIN), _RIGHT_CAROTID_END),
    "right_carotid_of_carotid_trunk": (_start(None, (0.1, 0.2, 0.3), _CAROTID, _THIN), _RIGHT_CAROTID_END),
    "right_carotid": (
        _start((0.2, 0, 1), (0.2, 0.2, 0), _CAROTID, _THIN),
        _carotid_end((-10, 0, 230), (2, 2, 0), (-0.2, 0, 1), (0.1, 0.1, 0), (-1, 0.33)),
    ),
    "left_subclavian": (_LEFT_ARM, _left_arm_end(5, 50, (1, 0.3, 0))),
    "left_subclavian_low": (_LEFT_ARM, _left_arm_end(5, 40, (1, 0.3, 0))),
    "left_subclavian_of_trunk": (_LEFT_ARM, _left_arm_end(15, 20, (1, 0.3, -0.1))),
    "right_subclavian_of_trunk": (_FORK_RIGHT_ARM, _right_arm_end(35, 25, (-1.2, 0, 0))),
    "right_subclavian_of_subclavian_trunk": (
        _FORK_RIGHT_ARM,
        _right_arm_end(15, 20, (-0.6, 0, -0.1), (0.1, 0.2, 0.1)),
    ),
    "right_subclavian_first": (_OWN_RIGHT_ARM, _right_arm_end(2, 50, (-1.2, 0, 0))),
    "right_subclavian_last": (_OWN_RIGHT_ARM, _right_arm_end(2, 42, (-1.2, -2.5, 0))),
}


def draw_course(
    name: str, start: Array, rng: np.random.Generator, *, parent: Knot | None = None, calibre: float = 1.0
) -> tuple[Knot, ...]:
    """Draws the knots of a vessel's course.

    Args:
        name: a key of COURSES.
        start: (3,) m, where it begins.
        parent: the last knot of the vessel that it continues.
        calibre: factor on the diameters.
    """
    knots: list[Knot] = []
    for waypoint in COURSES[name]:
        offset = np.array([0.0 if axis in waypoint.fixed else at for axis, at in zip("xyz", start, strict=True)])
        place = offset + MM * rng.normal(waypoint.place_mm, waypoint.place_spread_mm)
        mean = waypoint.heading
        if mean is None:
            assert parent is not None
            mean = tuple(parent.velocity.tolist())
        heading = rng.normal(mean, waypoint.heading_spread)
        velocity = rng.normal(*waypoint.swing) * heading / np.linalg.norm(heading)
        widening = rng.normal(*waypoint.widening)
        if waypoint.diameter_mm is None:
            assert parent is not None
            diameter, widening = parent.diameter, parent.widening
        else:
            before = knots[-1].diameter if knots else 0.0
            diameter = before + MM * calibre * rng.normal(*waypoint.diameter_mm)
            widening *= calibre
        knots.append(Knot(place, velocity, diameter, widening))
    return tuple(knots)


def course_curve(knots: tuple[Knot, ...]) -> tuple[Array, Array]:
    """The cubic Hermite curve through knots.

    Returns:
        Points (n, 3) m at even steps of about STEP, and radii (n,) m.
    """
    from scipy.interpolate import CubicHermiteSpline

    places = np.array([knot.place for knot in knots])
    chord = arc_length(places)
    values = np.column_stack((places, [knot.diameter for knot in knots]))
    slopes = np.array([[*knot.velocity, knot.widening] for knot in knots])
    curve = CubicHermiteSpline(chord, values, slopes)(np.linspace(0, chord[-1], round(chord[-1] / _SAMPLE) + 1))
    along = arc_length(curve[:, :3])
    even = np.linspace(0, along[-1], max(round(along[-1] / STEP), 4) + 1)
    sampled = np.stack([np.interp(even, along, curve[:, axis]) for axis in range(4)], axis=1)
    return sampled[:, :3], np.maximum(sampled[:, 3], MM * _LEAST_DIAMETER) / 2
