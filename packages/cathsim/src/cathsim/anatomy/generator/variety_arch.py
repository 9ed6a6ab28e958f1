"""Arches of the arch variety: drawn from their type and a seed, those that are no vessels drawn again."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.branching import STEP
from cathsim.anatomy.generator.scan_arch import drawn_tree
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.validation import Seed, settings

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Spread = tuple[float, float]  # mean and standard deviation

MM = 1e-3
_SAMPLE = 2e-4  # m of chord between the samples of a curve
_LEAST_DIAMETER = 4.0  # mm
_NONE = (0.0, 0.0, 0.0)


_CAROTID, _ARM = (1.5, 0.2), (2.0, 0.4)  # swings
_THIN: Spread = (10, 0.33)
_UP = (0.0, 0.0, 1.0)
CAROTID_TRUNK, SUBCLAVIAN_TRUNK = "carotid_trunk", "subclavian_trunk"
TRUNKS = ("bca", CAROTID_TRUNK, SUBCLAVIAN_TRUNK)
_END: Spread = (1.0, 0.0)
CALIBRE = 0.85  # factor on the generator's diameters in the published task
LEAST_WALL = 1e-3  # m of wall between the lumens of vessels that do not meet
TIGHTEST = 0.9  # curvature times radius of the aorta
_ATTEMPTS = 100


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
PATHS: dict[str, tuple[Waypoint, ...]] = {
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


def draw_path(
    name: str, start: Array, rng: np.random.Generator, *, parent: Knot | None = None, calibre: float = 1.0
) -> tuple[Knot, ...]:
    """Draws the knots of a vessel's path.

    Args:
        name: a key of PATHS.
        start: (3,) m, where it begins.
        parent: the last knot of the vessel that it continues.
        calibre: factor on the diameters.
    """
    knots: list[Knot] = []
    for waypoint in PATHS[name]:
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


def path_curve(knots: tuple[Knot, ...]) -> tuple[Array, Array]:
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


class Origin(NamedTuple):
    """A vessel and where it leaves its parent."""

    vessel: str
    path: str  # a key of `PATHS`
    # of the aorta: mm along its centreline from the origin before, or from the root; of a trunk: share of its length
    place: Spread
    parent: str = "aorta"


_RIGHT_PAIR = (
    Origin("rsa", "right_subclavian_of_trunk", _END, "bca"),
    Origin("rcca", "right_carotid_of_trunk", _END, "bca"),
)
_CAROTID_PAIR = (
    Origin("rcca", "right_carotid_of_carotid_trunk", _END, CAROTID_TRUNK),
    Origin("lcca", "left_carotid_of_trunk", _END, CAROTID_TRUNK),
)

# of each type the variants, equally likely; of each variant the vessels in order from the aortic root
BRANCHING: dict[str, tuple[tuple[Origin, ...], ...]] = {
    "I": (
        (
            Origin("bca", "trunk", (36, 5)),
            *_RIGHT_PAIR,
            Origin("lcca", "left_carotid", (16, 4)),
            Origin("lsa", "left_subclavian", (28, 3)),
        ),
    ),
    "II": (
        (
            Origin("bca", "trunk", (36, 3)),
            *_RIGHT_PAIR,
            Origin("lcca", "left_carotid_of_trunk", (2 / 3, 0.1), "bca"),
            Origin("lsa", "left_subclavian", (41, 2.5)),
        ),
    ),
    "IV": (
        (
            Origin("rsa", "right_subclavian_first", (42, 5)),
            Origin(CAROTID_TRUNK, "wide_trunk", (20, 4)),
            Origin("rcca", "right_carotid_of_trunk", _END, CAROTID_TRUNK),
            Origin("lcca", "left_carotid_of_trunk", _END, CAROTID_TRUNK),
            Origin("lsa", "left_subclavian_low", (38, 3)),
        ),
    ),
    "V": (
        (
            Origin(CAROTID_TRUNK, "trunk", (36, 3)),
            *_CAROTID_PAIR,
            Origin("lsa", "left_subclavian", (41, 2.5)),
            Origin("rsa", "right_subclavian_last", (20, 1)),
        ),
        (
            Origin("rcca", "right_carotid", (50, 2.5)),
            Origin("lcca", "left_carotid", (22, 3)),
            Origin("lsa", "left_subclavian", (26, 2.5)),
            Origin("rsa", "right_subclavian_last", (20, 1)),
        ),
    ),
    "VI": (
        (
            Origin(CAROTID_TRUNK, "trunk", (36, 3)),
            *_CAROTID_PAIR,
            Origin(SUBCLAVIAN_TRUNK, "wide_trunk", (50, 1.5)),
            Origin("rsa", "right_subclavian_of_subclavian_trunk", _END, SUBCLAVIAN_TRUNK),
            Origin("lsa", "left_subclavian_of_trunk", _END, SUBCLAVIAN_TRUNK),
        ),
    ),
    "VII": (
        (
            Origin("rsa", "right_subclavian_first", (38, 3.5)),
            Origin("rcca", "right_carotid", (20, 3)),
            Origin("lcca", "left_carotid", (20, 3)),
            Origin("lsa", "left_subclavian", (27, 3)),
        ),
    ),
}
ARCH_TYPES: tuple[str, ...] = tuple(BRANCHING)


@settings
class VarietyArch:
    """An arch of the arch variety: its branching type, the seed of its draws, and the factor on its diameters."""

    arch_type: str = "I"
    seed: Seed = 0
    calibre: Annotated[float, Interval(ge=0.7, le=1.3)] = CALIBRE

    def __post_init__(self) -> None:
        if self.arch_type not in ARCH_TYPES:
            raise ValueError(f"arch_type must be one of {', '.join(ARCH_TYPES)}, got {self.arch_type!r}")


def drawn_type(seed: int) -> str:
    """The branching type of a seed, each as likely as the others."""
    return ARCH_TYPES[int(np.random.default_rng([seed, len(ARCH_TYPES)]).integers(len(ARCH_TYPES)))]


def build_variety_arch(arch: VarietyArch) -> VesselTree:
    """Builds the vessel tree of an arch, centred on the origin.

    Returns:
        Branches aorta (from the descending end over the arch to the root), rsa, rcca, lcca, lsa, and as the type has
        them bca, carotid_trunk (of both carotids) and subclavian_trunk (of both subclavians).
    """
    rng = np.random.default_rng([arch.seed, ARCH_TYPES.index(arch.arch_type)])
    return drawn_tree(lambda: _draw(arch, rng), LEAST_WALL, _ATTEMPTS).centred()


def _draw(arch: VarietyArch, rng: np.random.Generator) -> VesselTree:
    """One draw.

    Raises:
        ValueError: the aorta bends too tightly, or a vessel does not leave its parent.
    """
    aorta = Branch("aorta", *path_curve(draw_path("aorta", np.zeros(3), rng, calibre=arch.calibre)))
    if _tightest(aorta) > TIGHTEST:
        raise ValueError("the aorta bends too tightly for its radius")
    branches, knots = {"aorta": aorta}, dict[str, Knot]()
    variants = BRANCHING[arch.arch_type]
    from_root = 0.0
    for origin in variants[int(rng.integers(len(variants)))]:
        parent = branches[origin.parent]
        place = float(rng.normal(*origin.place))
        if origin.parent == "aorta":
            from_root += MM * place
            place = parent.length - from_root
        else:
            place = parent.length * min(abs(place), 1.0)
        branches[origin.vessel], knots[origin.vessel] = _grow(origin, parent, place, knots, rng, arch.calibre)
    tree = VesselTree(tuple(branches.values()))
    for name in tree.names:
        tree.ostium_arc(name)
    return tree


def _grow(
    origin: Origin, parent: Branch, arc: float, knots: dict[str, Knot], rng: np.random.Generator, calibre: float
) -> tuple[Branch, Knot]:
    """The vessel of an origin at an arc length (m) along its parent, and its last knot."""
    path_knots = draw_path(origin.path, parent.point_at(arc), rng, parent=knots.get(origin.parent), calibre=calibre)
    points, radius = path_curve(path_knots)
    end = origin.vessel not in TRUNKS
    return Branch(origin.vessel, points, radius, parent.name, arc, open_end=end), path_knots[-1]


def _tightest(branch: Branch) -> float:
    """Largest curvature times radius, away from the ends."""
    turn = np.linalg.norm(np.gradient(branch.tangents, branch.arc, axis=0), axis=1)
    return float(np.max((turn * branch.radius)[5:-5]))
