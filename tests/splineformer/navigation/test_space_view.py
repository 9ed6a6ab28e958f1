"""The navigator's views of space and of the vessel."""

import functools

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import arc_length, at_length, resample
from splineformer.navigation.perception import CURVE_POINTS, WireReading
from splineformer.navigation.space_map import SpaceMap, hull_of
from splineformer.navigation.space_view import SIZE, WAY_MM, WIRE_MM, SpaceView
from splineformer.navigation.vessel_map import VesselMap, lumen_of_run
from tests.splineformer.navigation.drawn_moments import bend

PX, MAP = 512, 128
RADIUS_MM = 6.0


def cameras(turn: Rotation | None = None) -> list[Camera]:
    """Two views across each other, 800 mm from the source to the middle; the world may be turned under them."""
    turned = Rotation.identity() if turn is None else turn
    found = []
    for name, angle in (("a", 0.0), ("b", 80.0)):
        R = (Rotation.from_euler("y", angle, degrees=True) * turned.inv()).as_matrix()
        K = np.array([[1400.0, 0, PX / 2], [0, 1400.0, PX / 2], [0, 0, 1]])
        found.append(Camera(K, R, np.array([0.0, 0, 800.0]), PX, PX, name))
    return found


def lumen(camera: Camera, vessels: list[np.ndarray]) -> np.ndarray:
    """What a contrast run shows of vessels of a radius."""
    places = np.concatenate([resample(vessel, spacing=1.0) for vessel in vessels])
    cells = np.rint((camera.project(places) + 0.5) * MAP / PX - 0.5).astype(int)
    drawn = np.ones((MAP, MAP))
    drawn[cells[:, 1], cells[:, 0]] = 0.0
    cell_mm = 800 / 1400 * PX / MAP
    return 1.0 / (1.0 + np.exp(2 * (ndimage.distance_transform_edt(drawn) - RADIUS_MM / cell_mm)))


def marks(seen: list[Camera], place: np.ndarray) -> list[np.ndarray]:
    return [(camera.project(place) + 0.5) / PX for camera in seen]


def vessel(turn: Rotation | None = None) -> np.ndarray:
    """Up, then towards camera A and to the right: A sees the bend hardly, B sees it whole."""
    angle = np.linspace(0, 0.5 * np.pi, 40)
    bent = np.stack([20 * (1 - np.cos(angle)), -30 - 50 * np.sin(angle), -50 * (1 - np.cos(angle))], 1)
    points = np.concatenate([np.linspace((0, 60, 0), (0, -29, 0), 60), bent])
    return points if turn is None else turn.apply(points)


def readings(seen: list[Camera], wire: np.ndarray) -> list[WireReading]:
    found = []
    for camera in seen:
        points = resample((camera.project(wire) + 0.5) / PX, count=CURVE_POINTS)
        found.append(WireReading(np.zeros((5, 3), np.float32), points.astype(np.float32), np.zeros(8, np.float32), 0.9))
    return found


def space_of(turn: Rotation | None = None, others: list[np.ndarray] | None = None) -> SpaceMap:
    seen, way = cameras(turn), vessel(turn)
    hull = hull_of([lumen(camera, [way, *(others or [])]) for camera in seen], seen)
    return SpaceMap(hull, marks(seen, way[-1]))


@functools.cache
def plain_space() -> SpaceMap:
    """That of the vessel alone; nothing changes it."""
    return space_of()


def away(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of points from a dense line."""
    return np.linalg.norm(points[:, None] - resample(line, spacing=0.5)[None], axis=2).min(1)


def test_hull_is_the_vessel_and_little_more() -> None:
    space = plain_space()
    line = vessel()
    assert (space.sample(line) > 0.5).all()
    assert space.sample(line + np.array([0, 0, 20])).mean() < 0.1
    assert space.sample((400.0, 0, 0)) == 0
    there = np.argwhere(space.hull.lumen > 0.5) * 3.0 + space.hull.origin_mm
    assert np.quantile(away(there, line), 0.99) < 1.7 * RADIUS_MM


def test_way_through_the_hull_does_not_take_crossings_of_a_picture() -> None:
    # a second vessel that camera A sees cross the first one, 60 mm behind it
    other = np.linspace((-40, 40, 60), (60, -75, 60), 80)
    space = space_of(others=[other])
    way = space.way(vessel()[0])
    assert np.allclose(space.target, vessel()[-1], atol=1e-6)
    assert np.allclose(way[-1], space.target)
    assert away(way, vessel()).max() < 1.2 * RADIUS_MM
    length = arc_length(way)[-1]
    assert 0.9 < length / arc_length(vessel())[-1] < 1.1
    near = space.way(vessel()[0], 30.0)
    assert 30.0 <= arc_length(near)[-1] < 45.0
    assert space.remaining(vessel()[0]) > space.remaining(vessel()[40]) > space.remaining(space.target) == 0


def test_wire_is_measured_in_space() -> None:
    view = SpaceView(plain_space())
    wire = vessel()[:85][::-1]  # tip first
    generator = np.random.default_rng(0)
    seen = readings(list(view.space.hull.cameras), wire)
    for reading in seen:  # as far off as a network's curve
        reading.points[:] += generator.normal(0, 0.4 / PX, reading.points.shape)
    found, share = view.wire(seen)
    assert share > 0.9
    arcs = np.array([0.0, 10, 20, 30, 45])
    assert np.linalg.norm(at_length(found, arcs) - at_length(wire, arcs), axis=1).max() < 1.0


def test_look_is_measured_in_the_wires_own_frame() -> None:
    turn = Rotation.from_rotvec((0.4, -0.9, 0.3))
    looks = []
    for turned in (None, turn):
        view = SpaceView(space_of(turned))
        looks.append(view.look(readings(list(view.space.hull.cameras), vessel(turned)[:85][::-1])))
    plain, other = looks
    assert plain.shape == (SIZE,)
    count = 3 * (len(WAY_MM) + len(WIRE_MM))
    wire = slice(3 * len(WAY_MM), count)
    assert np.allclose(plain[wire], other[wire], atol=0.02)
    assert np.allclose(plain[: wire.start], other[: wire.start], atol=0.35)  # cells of the hull lie otherwise
    behind = plain[wire].reshape(-1, 3)
    assert (behind[:, 2] < -0.7).all()  # behind is behind
    assert (behind[1:, 1] > 0).all()  # y is the hollow side of the bend
    ahead = plain[: wire.start].reshape(-1, 3)
    assert (ahead[:, 2] > 0.5).all()
    assert np.abs(behind[:, 0]).max() < 0.1  # a plane bend has no third dimension


def test_what_cannot_be_measured_is_refused() -> None:
    seen = cameras()
    maps = [lumen(camera, [vessel()]) for camera in seen]
    with pytest.raises(ValueError, match="two cameras and their lumens"):
        hull_of(maps[:1], seen[:1])
    with pytest.raises(ValueError, match="no lumen in common"):
        hull_of([maps[0], np.zeros_like(maps[1])], seen)


def test_contrast_run_shows_the_lumen_whatever_the_brightness() -> None:
    true = np.kron(bend(), np.ones((4, 4)))
    plain = np.full((256, 256), 150.0)
    plain[:20] = 2.0  # behind the collimator
    contrast = 0.9 * plain * np.exp(-0.8 * true)
    noise = np.random.default_rng(0).normal(0, 1.5, (2, 256, 256))
    lumen = lumen_of_run((plain + noise[0]).clip(0, 255), (contrast + noise[1]).clip(0, 255), size=64)
    seen = bend() > 0.5
    seen[:5] = False
    assert np.array_equal(lumen > 0.5, seen)
    with pytest.raises(ValueError, match="shows no vessel"):
        lumen_of_run(plain, plain)
    with pytest.raises(ValueError, match="square images of one shape"):
        lumen_of_run(plain, contrast[:100])


def test_way_stays_in_the_lumen_and_ends_at_the_mark() -> None:
    vessels = VesselMap(bend(), (0.9, 0.19))
    way = vessels.way(np.array([0.19, 0.9]))
    assert np.allclose(way[0], (0.19, 0.9))
    assert np.allclose(way[-1], (0.9, 0.19))
    assert (vessels.sample(way) > 0.5).all()
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert 1.2 < length < 1.45  # the diagonal would be 1.0
    assert vessels.remaining(np.array([0.19, 0.9])) > vessels.remaining(np.array([0.19, 0.5])) > 0
    with pytest.raises(ValueError, match="must lie in the image"):
        VesselMap(bend(), (1.2, 0.5))


def test_curves_that_do_not_belong_together_count_as_not_measured() -> None:
    view = SpaceView(plain_space())
    one, other = readings(list(view.space.hull.cameras), vessel()[:85][::-1])
    other.points[:, 1] -= 0.25
    look = view.look([one, other])
    assert np.isfinite(look).all()
    assert look[-2] < 0.5  # measured share
    assert look[-1] == 5.0  # the tips' rays pass each other
    stub = np.tile(one.points[:1], (CURVE_POINTS, 1)) + np.linspace(0, 1e-4, CURVE_POINTS)[:, None].astype(np.float32)
    short = [WireReading(reading.tokens, stub, reading.encoded, 0.1) for reading in (one, one)]
    assert np.isfinite(view.look(short)).all()


def test_motion_is_that_since_earlier_decisions() -> None:
    view = SpaceView(plain_space())
    seen, line = list(view.space.hull.cameras), vessel()
    place = 3 * (len(WAY_MM) + len(WIRE_MM)) + 9 + 3
    first = view.look(readings(seen, line[:56][::-1]))
    assert np.allclose(first[place : place + 6], 0.0)
    second = view.look(readings(seen, line[:58][::-1]))
    step = np.linalg.norm(line[57] - line[55]) / 4.0
    assert np.allclose(second[place : place + 3], (0, 0, step), atol=0.12)
