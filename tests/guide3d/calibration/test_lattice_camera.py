"""Beads of a drawn cube: found, recognised as a lattice, numbered; with clutter, gaps and noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from guide3d.calibration.bead_cube import attenuation, find_beads, measure_beads
from guide3d.calibration.cube_orientation import candidates, decide
from guide3d.calibration.lattice_camera import CubeLattice, recognise_lattice
from guide3d.calibration.pinhole_fit import IntrinsicPrior
from guide3d.calibration.wire_marks import WireMark, find_marks
from guide3d.geometry.camera import Camera
from tests.guide3d.calibration.drawn_cube import (
    CAMERAS,
    DETECTORS,
    MARKED,
    POINTS_MM,
    drawn_cube_image,
    looking_camera,
    turned_cube,
)
from tests.guide3d.calibration.synthetic_xray import draw_cube

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


@pytest.mark.parametrize("seed", range(2))
def test_a_lattice_is_recognised_among_gaps_and_clutter(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.from_euler("xyz", rng.normal(size=3) * [0.15, 0.15, 0.5]).as_matrix()
    camera = turned_cube(looking_camera(0.5, 4900.0, 1250.0, 1024), R, rng.normal(size=3) * 15)
    pixels, true = seen_beads(camera, rng, dropped=0.5, clutter=10, noise_px=1.0)
    fit = recognise_lattice(LATTICE, pixels, 1024, 1024)
    assert same_up_to_symmetry(fit.numbers, true) > 0.97
    assert ((fit.numbers >= 0) & (true < 0)).sum() <= 3  # clutter that happens to lie within a few pixels
    on = fit.numbers >= 0
    off = np.linalg.norm(fit.camera.project(POINTS_MM[fit.numbers[on]]) - pixels[on], axis=1)
    assert off.mean() < 2.0


@pytest.mark.parametrize("guess", [3800.0, 6000.0])
def test_a_rough_guess_of_the_focal_length_will_do(guess):
    camera = looking_camera(0.5, 4900.0, 1250.0, 1024)
    pixels, true = seen_beads(camera, np.random.default_rng(0), 0.1, 5, 0.3)
    fit = recognise_lattice(LATTICE, pixels, 1024, 1024, prior=IntrinsicPrior(focal_px=guess))
    assert same_up_to_symmetry(fit.numbers, true) == 1.0


def test_too_few_beads_or_none_are_refused():
    rng = np.random.default_rng(0)
    pixels, _ = seen_beads(looking_camera(0.5, 4900.0, 1250.0, 1024), rng, 0.0, 0, 0.0)
    with pytest.raises(ValueError, match="expected 12 beads of the cube or more in the image, found 11"):
        recognise_lattice(LATTICE, pixels[:11], 1024, 1024)
    with pytest.raises(ValueError, match="expected a lattice that explains 12 of the 20 discs or more"):
        recognise_lattice(LATTICE, rng.uniform(0, 1024, size=(20, 2)), 1024, 1024)


def test_the_lattice_of_a_cube_has_24_rotations_and_of_a_box_fewer():
    assert LATTICE.symmetries.shape == (24, 64)
    assert all(sorted(symmetry) == list(range(64)) for symmetry in LATTICE.symmetries.tolist())
    box = POINTS_MM[POINTS_MM[:, 2] < 100]
    assert len(CubeLattice.of(box).symmetries) == 8
    with pytest.raises(ValueError, match="expected beads on a full lattice of one pitch, found 63 beads"):
        CubeLattice.of(POINTS_MM[:-1])


@pytest.mark.parametrize("detector", ["A", "B"])
def test_beads_are_found_and_measured(detector):
    image, numbers, true = drawn_cube_image(detector, CAMERAS[detector])
    beads = find_beads(image)
    distance, nearest = cKDTree(beads.centres_px).query(true)
    whole = (np.abs(true - 255.5) < 248).all(axis=1) & (np.linalg.norm(true - 255.5, axis=1) < 285)
    assert whole.sum() > 35
    assert (distance[whole] < 0.5).mean() > 0.94  # two beads in line may hide each other
    assert len(beads) <= len(true) + 1
    good = distance < 0.5
    assert np.sqrt((distance[good] ** 2).mean()) < 0.12
    expected = CAMERAS[detector].K[0, 0] / CAMERAS[detector].depth_mm(POINTS_MM[numbers]) * 2.5
    assert np.median(np.abs(beads.radii_px[nearest[good]].mean(axis=1) / expected[good] - 1)) < 0.12


def test_touching_beads_are_measured_together():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 6.0, 0.0]])
    camera = Camera(CAMERAS["A"].K, CAMERAS["A"].R, np.array([0.0, 0.0, 1150.0]), 512, 512)
    image, _, true = draw_cube(DETECTORS["A"], camera, points, np.random.default_rng(0), bead_mm=5.6)
    assert np.linalg.norm(true[0] - true[1]) < 13.5
    beads = measure_beads(image, true + 1.0, np.full(2, 6.0))
    assert np.abs(beads.centres_px - true).max() < 0.2
    alone = measure_beads(attenuation(image), true + 1.0, np.full(2, 6.0))
    assert np.array_equal(alone.centres_px, beads.centres_px)


def test_marks_are_told_apart_and_decide_the_attitude():
    poses, truth, single = {}, {}, {}
    for detector, camera in CAMERAS.items():
        image, numbers, raw = drawn_cube_image(detector, camera)
        beads = find_beads(image)
        distance, nearest = cKDTree(raw).query(beads.centres_px)
        truth[detector] = np.where(distance < 1, numbers[nearest], -1)
        undistort = DETECTORS[detector].undistort
        marks = [WireMark(mark.kind, undistort(mark.pixels)) for mark in find_marks(image, beads)]
        field = np.ones((512, 512), bool)
        fit = recognise_lattice(LATTICE, undistort(beads.centres_px), 512, 512, field)
        options = candidates(LATTICE, fit, field)
        assert len(options) % 24 == 0
        for option in options:
            on = option.numbers >= 0
            off = option.camera.project(POINTS_MM[option.numbers[on]]) - undistort(beads.centres_px)[on]
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
