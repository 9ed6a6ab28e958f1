"""Pairs of cameras against the published geometry, and their files."""

import json
from pathlib import Path

import numpy as np
import pytest

from cathsim.fluoroscopy import (
    DetectorDistortion,
    Projector,
    XRayCamera,
    askew_pair,
    clinical_pair,
    guide3d_pair,
    read_projection,
    write_calibration,
)

CENTRE = np.array([0.01, -0.02, 0.03])
REAL = Path(__file__).parents[4] / "shared" / "real" / "xray_calibration"


def test_public_geometry():
    a, b = (camera.projector for camera in guide3d_pair(CENTRE))
    assert np.linalg.norm(a.source - b.source) == pytest.approx(1.32, abs=1e-9)
    assert np.degrees(np.arccos(a.R[2] @ b.R[2])) == pytest.approx(91.0, abs=1e-9)
    assert a.K[0, 0] == pytest.approx(5150)
    assert b.K[0, 0] == pytest.approx(4450)
    for projector in (a, b):
        assert (projector.width, projector.height) == (1024, 1024)
        assert 0.18e-3 < 1 / projector.pixels_per_metre(CENTRE) < 0.20e-3
        np.testing.assert_allclose(projector.project(CENTRE[None]), [[511.5, 511.5]], atol=1e-9)
        right, down = projector.project(CENTRE + np.array([[0, 0, 0.01], [0.01, 0, 0]])) - 511.5
        assert right[0] > 30
        assert abs(right[1]) < 1e-9  # the head is to the right
        assert down[1] > 50
        assert projector.source_detector_distance > np.linalg.norm(projector.source - CENTRE)


def test_clinical_pair_is_frontal_and_lateral():
    a, b = clinical_pair(CENTRE, 256)
    np.testing.assert_allclose(a.projector.R[2], [0, 1, 0], atol=1e-12)
    assert abs(a.projector.R[2] @ b.projector.R[2]) < 1e-12
    assert a.distortion.identity


def test_askew_pair_is_the_public_one_turned_by_six_degrees():
    straight, askew = guide3d_pair(CENTRE, 256), askew_pair(CENTRE, 256).values()
    for camera, turned in zip(straight, askew, strict=True):
        np.testing.assert_allclose(turned.projector.project(CENTRE[None]), [[127.5, 127.5]], atol=1e-9)
        turn = np.trace(turned.projector.R @ camera.projector.R.T)
        assert np.degrees(np.arccos((turn - 1) / 2)) == pytest.approx(6.0, abs=1e-9)
        assert turned.distortion == camera.distortion


def test_undistorted_askew_cameras_differ_only_in_distortion():
    raw, ideal = askew_pair(CENTRE, 256), askew_pair(CENTRE, 256, distorted=False)
    point = CENTRE + np.array([[0.02, 0.03, -0.05]])
    for name in ("a", "b"):
        assert np.allclose(raw[name].projector.P, ideal[name].projector.P)
        assert np.allclose(ideal[name].pixels(point), ideal[name].projector.project(point))
        assert np.abs(raw[name].pixels(point) - ideal[name].pixels(point)).max() > 0.05


def test_roll_turns_the_image_and_nothing_else():
    upright = Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=200, primary_deg=20, secondary_deg=-10)
    turned = Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=200, primary_deg=20, secondary_deg=-10, roll_deg=90)
    points = CENTRE + np.random.default_rng(0).uniform(-0.05, 0.05, (20, 3))
    before, after = upright.project(points) - 99.5, turned.project(points) - 99.5
    np.testing.assert_allclose(after, np.column_stack((-before[:, 1], before[:, 0])), atol=1e-9)
    np.testing.assert_allclose(turned.source, upright.source, atol=1e-12)


def test_resized_camera_sees_the_same_places():
    points = CENTRE + np.random.default_rng(1).uniform(-0.07, 0.07, (20, 3))
    for camera in guide3d_pair(CENTRE):
        np.testing.assert_allclose((camera.pixels(points) + 0.5) / 8, camera.resized(128).pixels(points) + 0.5)


def test_files_hold_the_cameras(tmp_path):
    cameras = {camera.name: camera for camera in guide3d_pair(CENTRE, 512)}
    paths = write_calibration(cameras, tmp_path / "calibration")
    assert [path.name for path in paths] == ["calibration.json", "projection_a.txt", "projection_b.txt"]
    for name, camera in cameras.items():
        back, projector = read_projection(tmp_path / "calibration" / f"projection_{name}.txt"), camera.projector
        assert (back.width, back.height) == (512, 512)
        np.testing.assert_allclose(back.K, projector.K, rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(back.R, projector.R, atol=1e-11)
        np.testing.assert_allclose(back.t, 100 * projector.t, atol=1e-9)
        point = CENTRE + np.array([0.03, 0.01, -0.02])
        pixel = back.P @ [*(100 * point), 1]
        np.testing.assert_allclose(pixel[:2] / pixel[2], projector.project(point[None])[0], atol=1e-6)
        plain = json.loads(paths[0].read_text())["cameras"][name]
        np.testing.assert_array_equal(plain["P"], projector.P)
        assert plain["distortion"]["twist"] == camera.distortion.twist


def test_text_layout_is_that_of_the_laboratory(tmp_path):
    path = REAL / "projection_2024-03-04_16709.txt"
    if not path.exists():
        pytest.skip("needs the real calibration files beside the project, shared/real")
    real = read_projection(path)
    assert np.linalg.det(real.R) == pytest.approx(1, abs=1e-6)
    camera = guide3d_pair(CENTRE)[0]
    projector = Projector(real.K, real.R, real.t / 100, real.width, real.height, "b")
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


def test_text_that_a_spreadsheet_saved_is_read(tmp_path):
    camera = guide3d_pair(CENTRE)[0]
    path = write_calibration({"a": camera}, tmp_path)[1]
    text = path.read_text()
    path.write_text(text.replace(",", ";").replace(".", ",").replace("rotation", "rotation;;"), encoding="utf-8-sig")
    np.testing.assert_allclose(read_projection(path).P, camera.projector.P * [1, 1, 1, 100])


def test_bad_files_and_cameras_are_refused(tmp_path):
    path = tmp_path / "projection.txt"
    path.write_text("image size\n8,8\n\ncamera matrix\n1,0\n")
    with pytest.raises(ValueError, match="3 x 3 numbers under 'camera matrix'"):
        read_projection(path)
    path.write_text("hello\n")
    with pytest.raises(ValueError, match="no projection file"):
        read_projection(path)
    with pytest.raises(ValueError, match="unknown unit"):
        write_calibration({}, tmp_path, unit="inch")
    camera = guide3d_pair(CENTRE)[0]
    with pytest.raises(ValueError, match="resize one of them"):
        XRayCamera(camera.projector, DetectorDistortion.none(64, 64), camera.detector)
