"""Fitting cameras: linear, robust, refined; rigs with covariances checked against repetition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from guide3d.calibration.pinhole_fit import (
    direct_linear_transformation,
    projection_jacobian,
    ransac_camera,
    refine_camera,
    turned,
)
from guide3d.calibration.rig import Sighting, calibrate_rig
from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import swirl_pattern
from tests.guide3d.calibration.drawn_cube import POINTS_MM, looking_camera, turned_cube

RIG = {"A": looking_camera(0.4, 5100.0, 1150.0, 1024), "B": looking_camera(1.99, 4450.0, 900.0, 1024)}
SIZES = {"A": (1024, 1024), "B": (1024, 1024)}
TURNS = [[0.0, 0.0, 0.0], [0.25, -0.2, 0.5], [-0.2, 0.3, -0.4]]


def sightings(seed: int, noise_px: float, poses: int = 3, swirl_px: float = 0.0) -> list[Sighting]:
    rng = np.random.default_rng(seed)
    seen = []
    for pose, turn in enumerate(TURNS[:poses]):
        for detector, camera in RIG.items():
            placed = turned_cube(
                camera, Rotation.from_euler("xyz", turn).as_matrix(), 20.0 * np.array([pose, -pose, 0])
            )
            pixels = placed.project(POINTS_MM)
            inside = np.flatnonzero(placed.contains(pixels))
            pixels = pixels[inside] - swirl_px * swirl_pattern(pixels[inside], 1024, 1024)
            seen.append(Sighting(f"pose{pose}", detector, inside, pixels + noise_px * rng.normal(size=pixels.shape)))
    return seen


def parameters(camera: Camera, truth: Camera) -> np.ndarray:
    """The eleven parameters of a camera as differences from the true ones."""
    K, K0 = camera.K, truth.K
    turn = Rotation.from_matrix(camera.R @ truth.R.T).as_rotvec()
    intrinsics = [K[0, 0], K[1, 1], K[0, 1], K[0, 2], K[1, 2]], [K0[0, 0], K0[1, 1], K0[0, 1], K0[0, 2], K0[1, 2]]
    return np.concatenate([np.subtract(*intrinsics), turn, camera.t_mm - truth.t_mm])


def test_the_jacobian_is_that_of_the_projection():
    camera = RIG["A"]
    pixels, J = projection_jacobian(camera.K, camera.R, camera.t_mm, POINTS_MM)
    assert np.allclose(pixels, camera.project(POINTS_MM))
    for column in range(11):
        step = np.zeros(11)
        step[column] = 1e-5
        moved = []
        for s in (step, -step):
            K = camera.K + np.array([[s[0], s[2], s[3]], [0, s[1], s[4]], [0, 0, 0]])
            moved.append(Camera(K, turned(camera.R, s[5:8]), camera.t_mm + s[8:], 9, 9).project(POINTS_MM))
        assert np.allclose((moved[0] - moved[1]) / 2e-5, J[:, :, column], rtol=1e-4, atol=1e-4)


def test_exact_points_give_the_exact_camera():
    P = direct_linear_transformation(POINTS_MM, RIG["B"].project(POINTS_MM))
    assert np.allclose(Camera.from_P(P, 1024, 1024).K, RIG["B"].K, rtol=1e-6)
    with pytest.raises(ValueError, match="expected six points or more and as many pixels, found 5 and 5"):
        direct_linear_transformation(POINTS_MM[:5], np.zeros((5, 2)))


def test_wrong_pairs_are_left_out():
    rng = np.random.default_rng(0)
    pixels = RIG["A"].project(POINTS_MM) + 0.3 * rng.normal(size=(64, 2))
    wrong = rng.choice(64, 20, replace=False)
    pixels[wrong] += rng.uniform(20, 200, size=(20, 2))
    camera, agree = ransac_camera(POINTS_MM, pixels, 1024, 1024)
    assert np.array_equal(np.flatnonzero(~agree), np.sort(wrong))
    refined = refine_camera(camera, POINTS_MM[agree], pixels[agree])
    assert np.abs(refined.project(POINTS_MM) - RIG["A"].project(POINTS_MM)).max() < 0.6
    again, _ = ransac_camera(POINTS_MM, pixels, 1024, 1024)
    assert np.array_equal(again.P, camera.P)
    with pytest.raises(ValueError, match="expected a camera that most of 64 points agree with"):
        ransac_camera(POINTS_MM, rng.uniform(0, 1024, size=(64, 2)), 1024, 1024, rounds=30)


def test_a_rig_is_found_again_without_noise():
    result = calibrate_rig(POINTS_MM, sightings(0, 1e-4), SIZES)
    for detector, camera in result.cameras.items():
        assert np.allclose(camera.K, RIG[detector].K, atol=0.02)
        assert np.allclose(camera.centre_mm, RIG[detector].centre_mm, atol=0.02)
    assert result.noise_px < 2e-4
    Q, _ = result.poses["pose1"]
    assert np.allclose(Q, Rotation.from_euler("xyz", TURNS[1]).as_matrix(), atol=1e-5)
    assert all(used.all() for used in result.used.values())


def test_covariances_are_those_of_repetition():
    runs = [calibrate_rig(POINTS_MM, sightings(seed, 0.4, 2), SIZES, swirl="never") for seed in range(40)]
    for detector, truth in RIG.items():
        off = np.array([parameters(run.cameras[detector], truth) for run in runs])
        claimed = np.mean([np.diag(run.cameras[detector].covariance) for run in runs], axis=0)
        ratio = (off**2).mean(axis=0) / claimed
        assert ((ratio > 0.5) & (ratio < 1.8)).all(), ratio  # 40 runs: the mean square is known to 22 per cent
        # not the variances alone: the whole covariance, by its Mahalanobis distances (11 degrees of freedom)
        inverse = np.linalg.inv(runs[0].cameras[detector].covariance)
        assert 8.5 < np.einsum("ri,ij,rj->r", off, inverse, off).mean() < 13.5
    assert np.mean([run.noise_px for run in runs]) == pytest.approx(0.4, rel=0.05)


def test_a_swirl_is_estimated_where_there_is_one_and_only_there():
    with_one = calibrate_rig(POINTS_MM, sightings(1, 0.3, 1, swirl_px=2.0), SIZES)
    without = calibrate_rig(POINTS_MM, sightings(1, 0.3, 1), SIZES)
    for detector in SIZES:
        assert abs(with_one.swirl_px[detector] - 2.0) < 4 * with_one.swirl_sd_px[detector] < 1.0
        assert without.swirl_px[detector] == 0.0
    never = calibrate_rig(POINTS_MM, sightings(1, 0.3, 1, swirl_px=2.0), SIZES, swirl="never")
    assert never.noise_px > 1.3 * with_one.noise_px


def test_outliers_and_poses_of_another_rig_are_left_out():
    seen = sightings(2, 0.3)
    pixels = seen[0].pixels.copy()
    pixels[3] += 8.0
    seen[0] = Sighting(seen[0].pose, seen[0].detector, seen[0].numbers, pixels)
    result = calibrate_rig(POINTS_MM, seen, SIZES)
    assert not result.used["pose0", "A"][3]
    kept = result.residuals_px["pose0", "A"][result.used["pose0", "A"]]
    assert np.linalg.norm(kept, axis=1).max() < 2.0
    moved = turned_cube(RIG["B"], Rotation.from_euler("z", 0.05).as_matrix(), np.array([30.0, 0, 0]))
    pixels = moved.project(POINTS_MM)
    inside = np.flatnonzero(moved.contains(pixels))
    seen[3] = Sighting("pose1", "B", inside, pixels[inside])
    result = calibrate_rig(POINTS_MM, seen, SIZES)
    assert list(result.left_out) == ["pose1"]
    assert "stood elsewhere" in result.left_out["pose1"]
    assert np.allclose(result.cameras["B"].centre_mm, RIG["B"].centre_mm, atol=8.0)


def test_bad_sightings_are_refused():
    with pytest.raises(ValueError, match="expected sightings of the cube, found none"):
        calibrate_rig(POINTS_MM, [], SIZES)
    few = sightings(0, 0.1, 1)[0]
    with pytest.raises(ValueError, match="pose0, detector A: expected 12 beads or more, found 11"):
        calibrate_rig(POINTS_MM, [Sighting("pose0", "A", few.numbers[:11], few.pixels[:11])], SIZES)
    with pytest.raises(ValueError, match='expected swirl "auto", "never" or "always"'):
        calibrate_rig(POINTS_MM, [few], SIZES, swirl="perhaps")
