"""Rigs and lattices of beads: cameras, covariances, recognition, folders of images."""

import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from guide3d.calibration.bead_cube import find_beads
from guide3d.calibration.cube_orientation import candidates, decide
from guide3d.calibration.folder import cameras_in, rigs_in
from guide3d.calibration.lattice_camera import CubeLattice, recognise_lattice
from guide3d.calibration.pinhole_fit import ransac_camera, refine_camera
from guide3d.calibration.rig import Sighting, calibrate_rig
from guide3d.calibration.wire_marks import WireMark, find_marks
from guide3d.geometry.camera import Camera, write_camera, write_opencv_yaml
from guide3d.reconstruction.synthetic_scene import scenes
from tests.guide3d.calibration.drawn_cube import (
    CAMERAS,
    DETECTORS,
    MARKED,
    POINTS_MM,
    drawn_cube_image,
    looking_camera,
    turned_cube,
)

RIG = {"A": looking_camera(0.4, 5100.0, 1150.0, 1024), "B": looking_camera(1.99, 4450.0, 900.0, 1024)}
SIZES = {"A": (1024, 1024), "B": (1024, 1024)}
TURNS = [[0.0, 0.0, 0.0], [0.25, -0.2, 0.5], [-0.2, 0.3, -0.4]]


def sightings(seed: int, noise_px: float, poses: int = 3) -> list[Sighting]:
    rng = np.random.default_rng(seed)
    seen = []
    for pose, turn in enumerate(TURNS[:poses]):
        for detector, camera in RIG.items():
            rotation = Rotation.from_euler("xyz", turn).as_matrix()
            placed = turned_cube(camera, rotation, 20.0 * np.array([pose, -pose, 0]))
            pixels = placed.project(POINTS_MM)
            inside = np.flatnonzero(placed.contains(pixels))
            pixels = pixels[inside] + noise_px * rng.normal(size=(len(inside), 2))
            seen.append(Sighting(f"pose{pose}", detector, inside, pixels))
    return seen


def parameters(camera: Camera, truth: Camera) -> np.ndarray:
    """The eleven parameters of a camera as differences from the true ones."""
    K, K0 = camera.K, truth.K
    turn = Rotation.from_matrix(camera.R @ truth.R.T).as_rotvec()
    intrinsics = [K[0, 0], K[1, 1], K[0, 1], K[0, 2], K[1, 2]], [K0[0, 0], K0[1, 1], K0[0, 1], K0[0, 2], K0[1, 2]]
    return np.concatenate([np.subtract(*intrinsics), turn, camera.t_mm - truth.t_mm])


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


LATTICE = CubeLattice.of(POINTS_MM)


def same_up_to_symmetry(numbers: np.ndarray, true: np.ndarray) -> float:
    """The share of discs numbered rightly under the best rotation and shift of the lattice."""
    best = 0.0
    on = (numbers >= 0) & (true >= 0)
    for symmetry in LATTICE.symmetries:
        away = LATTICE.sites[symmetry[numbers[on]]] - LATTICE.sites[true[on]]
        _, counts = np.unique(away, axis=0, return_counts=True)
        best = max(best, counts.max() / (true >= 0).sum())
    return best


def seen_beads(camera: Camera, rng: np.random.Generator, dropped: float, clutter: int, noise_px: float):
    """Pixels of the beads in the image, some dropped, some added; and their true numbers."""
    pixels = camera.project(POINTS_MM) + noise_px * rng.normal(size=(64, 2))
    keep = camera.contains(pixels) & (rng.random(64) >= dropped)
    true = np.concatenate([np.flatnonzero(keep), np.full(clutter, -1)])
    pixels = np.concatenate([pixels[keep], rng.uniform(0, camera.width, size=(clutter, 2))])
    order = rng.permutation(len(true))
    return pixels[order], true[order]


def test_a_lattice_is_recognised_among_gaps_and_clutter():
    rng = np.random.default_rng(0)
    R = Rotation.from_euler("xyz", rng.normal(size=3) * [0.15, 0.15, 0.5]).as_matrix()
    camera = turned_cube(looking_camera(0.5, 4900.0, 1250.0, 1024), R, rng.normal(size=3) * 15)
    pixels, true = seen_beads(camera, rng, dropped=0.5, clutter=10, noise_px=1.0)
    fit = recognise_lattice(LATTICE, pixels, 1024, 1024)
    assert same_up_to_symmetry(fit.numbers, true) > 0.97
    assert ((fit.numbers >= 0) & (true < 0)).sum() <= 3  # clutter that happens to lie within a few pixels
    on = fit.numbers >= 0
    off = np.linalg.norm(fit.camera.project(POINTS_MM[fit.numbers[on]]) - pixels[on], axis=1)
    assert off.mean() < 2.0


def test_too_few_beads_or_none_are_refused():
    rng = np.random.default_rng(0)
    pixels, _ = seen_beads(looking_camera(0.5, 4900.0, 1250.0, 1024), rng, 0.0, 0, 0.0)
    with pytest.raises(ValueError, match="expected 12 beads of the cube or more in the image, found 11"):
        recognise_lattice(LATTICE, pixels[:11], 1024, 1024)
    with pytest.raises(ValueError, match="expected a lattice that explains 12 of the 20 discs or more"):
        recognise_lattice(LATTICE, rng.uniform(0, 1024, size=(20, 2)), 1024, 1024)


@functools.cache
def found_beads(detector: str):
    """A drawn image, its beads' numbers and pixels, and the beads that are found in it."""
    image, numbers, true = drawn_cube_image(detector, CAMERAS[detector])
    return image, numbers, true, find_beads(image)


@pytest.mark.parametrize("detector", ["A", "B"])
def test_beads_are_found_and_measured(detector):
    _, numbers, true, beads = found_beads(detector)
    distance, nearest = cKDTree(beads.centres_px).query(true)
    whole = (np.abs(true - 255.5) < 248).all(axis=1) & (np.linalg.norm(true - 255.5, axis=1) < 285)
    assert whole.sum() > 35
    assert (distance[whole] < 0.5).mean() > 0.94  # two beads in line may hide each other
    assert len(beads) <= len(true) + 1
    good = distance < 0.5
    assert np.sqrt((distance[good] ** 2).mean()) < 0.12
    expected = CAMERAS[detector].K[0, 0] / CAMERAS[detector].depth_mm(POINTS_MM[numbers]) * 2.5
    assert np.median(np.abs(beads.radii_px[nearest[good]].mean(axis=1) / expected[good] - 1)) < 0.12


def test_marks_are_told_apart_and_decide_the_attitude():
    poses, truth, single = {}, {}, {}
    for detector in CAMERAS:
        image, numbers, raw, beads = found_beads(detector)
        distance, nearest = cKDTree(raw).query(beads.centres_px)
        truth[detector] = np.where(distance < 1, numbers[nearest], -1)
        undistort = DETECTORS[detector].undistort
        marks = [WireMark(mark.kind, undistort(mark.pixels)) for mark in find_marks(image, beads)]
        field, pixels = np.ones((512, 512), bool), undistort(beads.centres_px)
        fit = recognise_lattice(LATTICE, pixels, 512, 512, field)
        options = candidates(LATTICE, fit, field)
        assert len(options) % 24 == 0
        for option in options:
            on = option.numbers >= 0
            off = option.camera.project(POINTS_MM[option.numbers[on]]) - pixels[on]
            assert np.abs(off).mean() < 0.3
        poses[detector] = (options, marks, field)
        single[detector] = {mark.kind for mark in marks}
    assert single["A"] | single["B"] >= {"single", "circle"}
    chosen, certain = decide(LATTICE, [poses], MARKED)
    assert certain == [True]
    for detector, choice in chosen[0].items():
        numbers = poses[detector][0][choice].numbers
        on = truth[detector] >= 0
        assert (numbers[on] == truth[detector][on]).mean() > 0.97
    assert decide(LATTICE, [poses], {})[1] == [False]


FOLDER_CAMERAS = next(iter(scenes(1, seed=5))).cameras


def _write(folder: Path, *names: str) -> Path:
    for camera, name in zip(FOLDER_CAMERAS, names, strict=False):
        write_opencv_yaml(camera, folder / name)
    return folder


@pytest.mark.parametrize(
    ("names", "name"),
    [
        (("cam_16710.yaml", "cam_16709.yaml"), "cam_*.yaml"),
        (("camera_a.yaml", "camera_b.yaml"), "*.yaml"),
        (("Cam_16710.YML", "Cam_16709.YML"), "Cam_*.YML"),
        (("left_16710.yaml", "right_16709.yaml"), "left_16710.yaml, right_16709.yaml"),
    ],
)
def test_one_set_is_found(tmp_path: Path, names: tuple[str, str], name: str) -> None:
    _write(tmp_path / "calibration", *names)
    (rig,) = rigs_in(tmp_path)
    cameras = cameras_in(tmp_path)
    assert rig.name == name
    for camera, read, expected in zip(rig.cameras, cameras, FOLDER_CAMERAS, strict=True):
        assert np.allclose(camera.P, expected.P)
        assert np.array_equal(camera.P, read.P)


@pytest.mark.parametrize(("ending", "unit", "away"), [("txt", "mm", r"\d+e\+0\d|\d{4}"), ("yaml", "cm", r"\d\d\.\d+")])
def test_cameras_in_another_unit_are_refused(tmp_path: Path, ending: str, unit: str, away: str) -> None:
    for camera, detector in zip(FOLDER_CAMERAS, (16710, 16709), strict=True):
        path = tmp_path / f"cam_{detector}.{ending}"
        (write_camera if ending == "txt" else write_opencv_yaml)(camera, path, unit)
        if ending == "yaml":
            path.write_text(path.read_text().replace("world_unit", "made_in"))
    with pytest.raises(ValueError, match=rf"cam_16709\.{ending}: the views meet ({away}) mm from the X-ray sources"):
        rigs_in(tmp_path)


def test_several_sets_are_listed_or_refused(tmp_path: Path) -> None:
    _write(tmp_path, "may_16710.yaml", "may_16709.yaml")
    _write(tmp_path, "june_16710.yaml", "june_16709.yaml")
    assert [rig.name for rig in rigs_in(tmp_path)] == ["june_*.yaml", "may_*.yaml"]
    with pytest.raises(ValueError, match=r"several sets of cameras \(june_\*.yaml, may_\*.yaml\)"):
        cameras_in(tmp_path)


def test_half_a_set_or_none(tmp_path: Path) -> None:
    assert cameras_in(tmp_path) is None
    with pytest.raises(FileNotFoundError, match="holds no cameras"):
        rigs_in(tmp_path)
    _write(tmp_path, "may_16710.yaml")
    for read in (cameras_in, rigs_in):
        with pytest.raises(FileNotFoundError, match=r"camera B, \*16709\*.txt or .yaml, is missing"):
            read(tmp_path)
    with pytest.raises(FileNotFoundError, match="expected a folder with camera files"):
        cameras_in(tmp_path / "none")


def test_bad_sightings_are_refused():
    with pytest.raises(ValueError, match="expected sightings of the cube, found none"):
        calibrate_rig(POINTS_MM, [], SIZES)
    few = sightings(0, 0.1, 1)[0]
    with pytest.raises(ValueError, match="pose0, detector A: expected 12 beads or more, found 11"):
        calibrate_rig(POINTS_MM, [Sighting("pose0", "A", few.numbers[:11], few.pixels[:11])], SIZES)
    with pytest.raises(ValueError, match='expected swirl "auto", "never" or "always"'):
        calibrate_rig(POINTS_MM, [few], SIZES, swirl="perhaps")


def test_the_lattice_of_a_cube_has_24_rotations_and_of_a_box_fewer():
    assert LATTICE.symmetries.shape == (24, 64)
    assert all(sorted(symmetry) == list(range(64)) for symmetry in LATTICE.symmetries.tolist())
    box = POINTS_MM[POINTS_MM[:, 2] < 100]
    assert len(CubeLattice.of(box).symmetries) == 8
    with pytest.raises(ValueError, match="expected beads on a full lattice of one pitch, found 63 beads"):
        CubeLattice.of(POINTS_MM[:-1])
