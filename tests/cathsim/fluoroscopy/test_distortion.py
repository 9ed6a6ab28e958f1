"""The intensifier's map: its size, its inverse, its derivative, and what it refuses."""

import json

import numpy as np
import pytest

from cathsim.fluoroscopy import DetectorDistortion, guide3d_pair

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


@pytest.mark.parametrize("distortion", MAPS)
def test_jacobian_is_the_derivative(distortion):
    points, step = grid(1024, 100), 1e-3
    J = distortion.jacobian(points)
    for k in range(2):
        shift = step * np.eye(2)[k]
        numeric = (distortion.distort(points + shift) - distortion.distort(points - shift)) / (2 * step)
        np.testing.assert_allclose(J[:, :, k], numeric, atol=1e-6)


def test_terms_by_hand():
    distortion = DetectorDistortion(101, 101, pincushion=0.1, barrel=-0.02, twist=0.05)
    half, middle = 50.5, 50.0
    x, y, r2 = 0.6, -0.3, 0.45
    expected = [
        x * (1 + 0.1 * r2 - 0.02 * r2 * r2) - y * 0.05 * r2,
        y * (1 + 0.1 * r2 - 0.02 * r2 * r2) + x * 0.05 * r2,
    ]
    given = distortion.distort([[middle + half * x, middle + half * y]])
    np.testing.assert_allclose(given[0], middle + half * np.array(expected))


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
    with pytest.raises(ValueError, match="too far outside the image"):
        MAPS[1].undistort([[1e5, 0.0]])


def test_json_repeats_the_map():
    plain = json.loads(json.dumps(MAPS[0].to_json()))
    names = ("width", "height", "pincushion", "barrel", "twist", "tilt", "centre")
    again = DetectorDistortion(
        **{name: tuple(plain[name]) if isinstance(plain[name], list) else plain[name] for name in names}
    )
    assert again == MAPS[0]
    assert "r2" in plain["model"]


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="folds the image"):
        DetectorDistortion(64, 64, pincushion=-0.5)
    with pytest.raises(ValueError, match="twist must be a finite number"):
        DetectorDistortion(64, 64, twist=np.nan)
    with pytest.raises(ValueError, match=r"shape \(n, 2\)"):
        MAPS[0].distort(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="width must lie in 1 to 8192 px, got 0"):
        DetectorDistortion(0, 4)
