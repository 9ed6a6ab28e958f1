"""Views: projections, lenses, C-arms of laboratories and their files."""

import json
from pathlib import Path

import numpy as np
import pytest

from cathsim.fluoroscopy import (
    VIEWS,
    DetectorDistortion,
    Projector,
    XRayCamera,
    guide3d_pair,
    write_calibration,
)

BOUNDS = np.array([[-0.06, -0.04, -0.11], [0.05, 0.05, 0.12]])
CENTRE = BOUNDS.mean(axis=0)
C_ARM = {"centre": CENTRE, "field_of_view": 0.2, "size": 80}


def beside(x, y, z):
    return CENTRE + np.array([x, y, z])


def corners(bounds):
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def test_frontal_view_is_radiological():
    camera = Projector.frontal(BOUNDS, 80)
    centre, left, up = camera.project([CENTRE, beside(0.02, 0, 0), beside(0, 0, 0.02)])
    assert centre == pytest.approx([39.5, 39.5])
    assert left[0] > centre[0]
    assert left[1] == pytest.approx(centre[1])
    assert up[1] < centre[1]
    assert up[0] == pytest.approx(centre[0])
    assert camera.source[1] < BOUNDS[0, 1]


def test_magnification_follows_the_distances():
    camera = Projector.c_arm(
        centre=CENTRE, field_of_view=0.2, size=(200, 100), source_detector_distance=1.0, source_object_distance=0.8
    )
    assert (camera.width, camera.height) == (200, 100)
    here, there = camera.project([CENTRE, beside(0.01, 0, 0)])
    assert there[0] - here[0] == pytest.approx(5.0)  # 100 px over 0.2 m
    assert camera.pixels_per_metre(CENTRE) == pytest.approx(500.0)
    assert camera.pixels_per_metre(beside(0, 0.08, 0)) == pytest.approx(500.0 * 0.8 / 0.88)
    assert np.linalg.norm(camera.source - CENTRE) == pytest.approx(0.8)


@pytest.mark.parametrize(("primary", "secondary", "axis", "sign"), [(90, 0, 0, 1), (-90, 0, 0, -1), (0, 80, 2, 1)])
def test_angles_turn_the_arm_as_named(primary, secondary, axis, sign):
    camera = Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=64, primary_deg=primary, secondary_deg=secondary)
    direction = (camera.source - CENTRE) / 0.75
    assert sign * direction[axis] > 0.98
    assert np.linalg.det(camera.R) == pytest.approx(1.0)
    up = camera.project([beside(0, 0, 0.01)])[0]
    assert up[1] < 31.5


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("size", [80, 128, (320, 200)])
def test_the_whole_box_is_in_view_and_fills_it(name, size):
    camera = Projector.view(name, BOUNDS, size)
    pixels = camera.project(corners(BOUNDS))
    extent = np.array([camera.width, camera.height])
    assert (pixels > -0.5).all()
    assert (pixels < extent - 0.5).all()
    assert (np.abs(pixels - (extent - 1) / 2).max(axis=0) / extent).max() > 0.45
    assert camera.name == name


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Projector.view("oblique", BOUNDS, 80), "unknown view 'oblique'"),
        (lambda: Projector.frontal(BOUNDS[::-1], 80), "lowest and the highest corner"),
        (lambda: Projector.c_arm(**C_ARM, source_object_distance=2.0), "between source and detector"),
        (lambda: Projector.c_arm(**C_ARM | {"field_of_view": 0.0}), "field of view"),
        (lambda: Projector.c_arm(**C_ARM, secondary_deg=90), "secondary angle"),
        (lambda: Projector.frontal(BOUNDS, 0), "width must lie in"),
        (lambda: Projector(np.eye(3), np.diag([1.0, 1.0, -1.0]), np.zeros(3), 8, 8), "must be a rotation"),
        (lambda: Projector.frontal(BOUNDS, 80).project(np.zeros(3)), r"shape \(n, 3\)"),
        (lambda: Projector.frontal(BOUNDS, 80).project([[0, -2.0, 0]]), "in front of the X-ray source"),
        (lambda: DetectorDistortion(64, 64, pincushion=-0.5), "folds the image"),
        (lambda: DetectorDistortion(0, 4), "width must lie in"),
        (lambda: MAPS[0].distort(np.zeros((3, 3))), r"shape \(n, 2\)"),
        (lambda: MAPS[1].undistort([[1e5, 0.0]]), "too far outside the image"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_unknown_units_and_unlike_cameras_are_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown unit"):
        write_calibration({}, tmp_path, unit="inch")
    camera = guide3d_pair(C_ARMS_CENTRE)[0]
    with pytest.raises(ValueError, match="resize one of them"):
        XRayCamera(camera.projector, DetectorDistortion.none(64, 64), camera.detector)


C_ARMS_CENTRE = np.array([0.01, -0.02, 0.03])
REAL = Path(__file__).parents[4] / "shared" / "real" / "xray_calibration"


def test_public_geometry():
    a, b = (camera.projector for camera in guide3d_pair(C_ARMS_CENTRE))
    assert np.linalg.norm(a.source - b.source) == pytest.approx(1.32, abs=1e-9)
    assert np.degrees(np.arccos(a.R[2] @ b.R[2])) == pytest.approx(91.0, abs=1e-9)
    assert a.K[0, 0] == pytest.approx(5150)
    assert b.K[0, 0] == pytest.approx(4450)
    for projector in (a, b):
        assert (projector.width, projector.height) == (1024, 1024)
        assert 0.18e-3 < 1 / projector.pixels_per_metre(C_ARMS_CENTRE) < 0.20e-3
        np.testing.assert_allclose(projector.project(C_ARMS_CENTRE[None]), [[511.5, 511.5]], atol=1e-9)
        right, down = projector.project(C_ARMS_CENTRE + np.array([[0, 0, 0.01], [0.01, 0, 0]])) - 511.5
        assert right[0] > 30
        assert abs(right[1]) < 1e-9  # the head is to the right
        assert down[1] > 50
        assert projector.source_detector_distance > np.linalg.norm(projector.source - C_ARMS_CENTRE)


def numbers_of(path):
    """Size (1, 2), K, R and t of a text file, world in the file's unit."""
    blocks = path.read_text().split("\n\n")
    return [np.array([row.split(",") for row in block.splitlines()[1:] if row], float) for block in blocks]


def test_files_hold_the_cameras(tmp_path):
    cameras = {camera.name: camera for camera in guide3d_pair(C_ARMS_CENTRE, 512)}
    paths = write_calibration(cameras, tmp_path / "calibration")
    assert [path.name for path in paths] == ["calibration.json", "projection_a.txt", "projection_b.txt"]
    for name, camera in cameras.items():
        size, K, R, t = numbers_of(tmp_path / "calibration" / f"projection_{name}.txt")
        projector = camera.projector
        assert size.tolist() == [[512, 512]]
        np.testing.assert_allclose(K, projector.K, rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(R, projector.R, atol=1e-11)
        np.testing.assert_allclose(t[:, 0], 100 * projector.t, atol=1e-9)
        point = C_ARMS_CENTRE + np.array([0.03, 0.01, -0.02])
        pixel = K @ (R @ (100 * point) + t[:, 0])
        np.testing.assert_allclose(pixel[:2] / pixel[2], projector.project(point[None])[0], atol=1e-6)
        plain = json.loads(paths[0].read_text())["cameras"][name]
        np.testing.assert_array_equal(plain["P"], projector.P)
        assert plain["distortion"]["twist"] == camera.distortion.twist


def test_text_layout_is_that_of_the_laboratory(tmp_path):
    path = REAL / "projection_2024-03-04_16709.txt"
    if not path.exists():
        pytest.skip("needs the real calibration files beside the project, shared/real")
    ((width, height),), K, rotation, t = numbers_of(path)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-6)
    camera = guide3d_pair(C_ARMS_CENTRE)[0]
    projector = Projector(K, rotation, t[:, 0] / 100, int(width), int(height), "b")
    ours = write_calibration(
        {"b": XRayCamera(projector, DetectorDistortion.none(1024, 1024), camera.detector)}, tmp_path
    )[1]
    ours_lines, their_lines = ours.read_bytes().split(b"\r\n"), path.read_bytes().split(b"\r\n")
    assert len(ours_lines) == len(their_lines)
    for one, other in zip(ours_lines, their_lines, strict=True):
        if b"," in other:
            np.testing.assert_allclose([float(x) for x in one.split(b",")], [float(x) for x in other.split(b",")])
        else:
            assert one == other


MAPS = [camera.distortion for camera in guide3d_pair(np.zeros(3))]


def grid(size, step):
    u, v = np.meshgrid(np.arange(0.0, size, step), np.arange(0.0, size, step))
    return np.column_stack((u.ravel(), v.ravel()))


@pytest.mark.parametrize("distortion", MAPS)
def test_inverse_gives_the_points_back(distortion):
    shown = grid(1024, 31)
    ideal = distortion.undistort(shown)
    np.testing.assert_allclose(distortion.distort(ideal), shown, atol=1e-6)
    np.testing.assert_allclose(distortion.undistort(distortion.distort(ideal)), ideal, atol=1e-6)


@pytest.mark.parametrize("camera", guide3d_pair(np.zeros(3)), ids=["a", "b"])
def test_displacement_is_as_large_as_measured_on_the_public_data(camera):
    shown = grid(1024, 8)
    lit = camera.detector.illumination(1024, 1024)[::8, ::8].ravel() > 0.02
    moved = np.linalg.norm(shown - camera.distortion.undistort(shown), axis=1)[lit]
    assert moved.mean() == pytest.approx(11, abs=1)
    assert moved.max() == pytest.approx(28, abs=2)


def test_size_scales_the_map_and_nothing_is_none():
    big, small = MAPS[0], MAPS[0].resized(256, 256)
    ideal = grid(1024, 64)
    shrunk = (ideal + 0.5) / 4 - 0.5
    np.testing.assert_allclose(small.distort(shrunk), (big.distort(ideal) + 0.5) / 4 - 0.5, atol=1e-9)
    flat = DetectorDistortion.none(64, 48)
    assert flat.identity
    np.testing.assert_array_equal(flat.distort(ideal), ideal)
    np.testing.assert_array_equal(flat.undistort(ideal), ideal)


def test_far_points_stay_far_and_in_order():
    line = np.column_stack((np.linspace(-5000, 6000, 400), np.full(400, 300.0)))
    moved = MAPS[1].distort(line)
    assert (np.diff(moved[:, 0]) > 0).all()
