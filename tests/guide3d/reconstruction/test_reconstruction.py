"""Matching, fitting and reconstruction on synthetic wires of known shape, and what they say of bad input."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.guide3d.reconstruction import numbers, picture
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.metrics import max_ed, mers, mete
from guide3d.geometry.polyline import arc_length, at_length, distances_to, resample
from guide3d.native_library import HOME, library, sources_digest
from guide3d.reconstruction.curve_fitting import CurveFitSettings
from guide3d.reconstruction.matching import Match, MatchingSettings, complete, image_curve, match_curves
from guide3d.reconstruction.reconstruction import ReconstructionSettings, reconstruct, reconstruct_greedy
from guide3d.reconstruction.synthetic_scene import KINDS, SyntheticScene, clicked, rig, scenes, wire

EXACT = list(scenes(16, seed=5))
CLICKED = list(scenes(40, seed=5, noise_px=1.0))


def of(scene: SyntheticScene, **settings: object):
    return reconstruct(*scene.cameras, *scene.points, settings=ReconstructionSettings(**settings))  # type: ignore[arg-type]


def test_the_native_code_is_that_of_the_sources() -> None:
    assert library().guide3d_sources().decode() == sources_digest(HOME / "native")


@pytest.mark.parametrize("kind", KINDS)
def test_exact_annotations_give_the_wire_back(kind: str) -> None:
    group = [scene for scene in EXACT if scene.kind == kind]
    errors = [
        (r := of(scene)) and (max_ed(r.curve_mm, scene.curve_mm), mete(r.curve_mm, scene.curve_mm)) for scene in group
    ]
    assert np.mean(errors, axis=0)[0] < 0.3
    assert np.max(errors, axis=0)[1] < 0.05


def test_clicks_with_noise_give_the_wire_within_its_own_uncertainty() -> None:
    means, tips, squares, noises = [], [], [], []
    for scene in CLICKED:
        result = of(scene)
        means.append(mers(result.curve_mm, scene.curve_mm))
        tips.append(mete(result.curve_mm, scene.curve_mm))
        noises.append(result.noise_px)
        length = min(result.length_mm, arc_length(scene.curve_mm)[-1])
        count = int(length / 0.5) + 1
        off = result.curve_mm[:count] - at_length(scene.curve_mm, 0.5 * np.arange(count))
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(result.covariance_mm2[:count]), off).mean() / 3)
    assert np.mean(means) < 0.5
    assert np.mean(tips) < 0.4
    assert 0.7 < np.mean(noises) < 1.2
    assert 0.4 < np.median(squares) < 1.6


def test_it_beats_the_greedy_variant_on_noise() -> None:
    ours = [mers(of(scene).curve_mm, scene.curve_mm) for scene in CLICKED[:16]]
    greedy = [mers(reconstruct_greedy(*s.cameras, *s.points).curve_mm, s.curve_mm) for s in CLICKED[:16]]
    assert np.mean(ours) < 0.5 * np.mean(greedy)


def test_the_greedy_variant_doubts_cameras_and_annotation_only_where_they_are_wrong() -> None:
    scene = CLICKED[33]
    a, b = scene.cameras
    sound = reconstruct_greedy(a, b, *scene.points)
    assert sound.coverage < 0.6, "it misses half of the wire"
    assert not [warning for warning in sound.warnings if "swapped" in warning or "tips" in warning]
    exchanged = reconstruct_greedy(b, a, *CLICKED[0].points)
    assert any("the cameras look swapped" in warning for warning in exchanged.warnings)


def test_matches_are_monotone_and_lie_on_the_true_pairs() -> None:
    scene = next(scene for scene in EXACT if scene.kind == "loop")
    a, b = scene.cameras
    match = match_curves(EpipolarGeometry(a, b), *(image_curve(points, 2.0) for points in scene.points))
    assert (np.diff(match.along_a) >= 0).all()
    assert (np.diff(match.along_b) >= 0).all()
    true = arc_length(b.project(scene.curve_mm)), arc_length(a.project(scene.curve_mm))
    expected = np.interp(match.along_a, true[1], true[0])
    assert np.median(np.abs(match.along_b - expected)) < 2.0
    assert match.coverage > 0.97


def test_a_wire_that_leaves_one_image_first_is_matched_to_there() -> None:
    scene = EXACT[0]
    a, b = scene.cameras
    full = of(scene)
    cut_px = 0.5 * arc_length(scene.points[1])[-1]
    shorter = resample(scene.points[1], spacing=1.0)[: int(cut_px)]
    result = reconstruct(a, b, scene.points[0], shorter)
    assert result.coverage > 0.97
    assert result.coverage_a < 0.8
    assert result.length_mm < 0.8 * full.length_mm
    assert max_ed(result.curve_mm, scene.curve_mm) < 1.0


def test_a_tip_missed_in_one_image_is_left_out() -> None:
    scene = EXACT[0]
    start = 40  # px
    result = reconstruct(*scene.cameras, scene.points[0], scene.points[1][start:])
    assert result.match.along_a[0] > 5.0
    assert distances_to(scene.curve_mm, result.curve_mm).mean() < 0.5


def test_gaps_are_completed_between_measured_pairs_and_no_further() -> None:
    line = np.stack([np.arange(0.0, 100.0, 2.0), np.zeros(50)], axis=1)
    along = np.arange(0.0, 80.0, 2.0)
    stalled = along.copy()
    stalled[15:25] = stalled[15]  # a path that stood still and jumped, with nothing measured
    measured = np.ones(40, dtype=bool)
    measured[16:25] = False
    measured[-2:] = False
    match = Match(along, stalled, line[:40], line[:40], np.zeros(40), measured, 98.0, 98.0, 0.0)
    done = complete(match, line, line, 2.0)
    assert np.abs(done.along_b - done.along_a).max() < 1.0
    assert np.array_equal(done.along_b[-2:], stalled[-2:])
    assert np.allclose(done.points_b[:, 0], done.along_b)
    assert done.covered("a") == pytest.approx((30.0 + 24.0) / 98.0)


def test_results_repeat_exactly() -> None:
    first, second = of(CLICKED[0]), of(CLICKED[0])
    assert np.array_equal(first.curve_mm, second.curve_mm)
    assert np.array_equal(first.covariance_mm2, second.covariance_mm2)


def test_points_are_even_and_tip_first_and_the_sd_is_the_trace() -> None:
    result = of(CLICKED[1])
    steps = np.linalg.norm(np.diff(result.curve_mm, axis=0), axis=1)
    assert np.abs(steps - 0.5).max() < 0.02
    assert np.allclose(result.sd_mm**2, np.trace(result.covariance_mm2, axis1=1, axis2=2))
    assert mete(result.curve_mm, CLICKED[1].curve_mm) < 2.0


def test_a_bad_reprojection_is_rejected() -> None:
    result = of(CLICKED[0], rejection_px=0.01)
    assert not result.accepted
    assert any("rejected" in warning for warning in result.warnings)
    assert of(CLICKED[0]).accepted


def test_swapped_cameras_are_told() -> None:
    warned = 0
    for scene in CLICKED[:12]:
        try:
            result = reconstruct(*scene.cameras[::-1], *scene.points)
        except ValueError as error:
            warned += "swapped" in str(error)
        else:
            warned += any("swapped" in warning for warning in result.warnings)
    assert warned >= 7
    assert not any("swapped" in warning for scene in CLICKED[:12] for warning in of(scene).warnings)


def test_bad_annotations_are_refused_in_one_sentence() -> None:
    scene = CLICKED[0]
    a, b = scene.points
    with pytest.raises(ValueError, match="annotation of camera B: expected at least 2 different points, got 1"):
        reconstruct(*scene.cameras, a, b[:1])
    with pytest.raises(
        ValueError, match=r"annotation of camera A: point 0 at .* lies outside the image of 1024 x 1024"
    ):
        reconstruct(*scene.cameras, a + np.array([3000.0, 0.0]), b)
    with pytest.raises(ValueError, match="annotation of camera A: expected a curve of at least"):
        reconstruct(*scene.cameras, a[:1] + np.array([[0.0, 0.0], [1.0, 0.0]]), b)
    with pytest.raises(ValueError, match="no stretch in common"):
        reconstruct(*scene.cameras, a * [1.0, 0.1], 1000.0 - b * [1.0, 0.1])


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="match_px must be greater than 0, got 0"):
        MatchingSettings(match_px=0.0)
    with pytest.raises(ValueError, match="bending_per_mm must be greater than 0, got -1"):
        CurveFitSettings(bending_per_mm=-1.0)


def test_the_report_has_plain_numbers_and_a_picture() -> None:
    scene = CLICKED[2]
    result = of(scene)
    figures = numbers(result)
    assert figures["mean_px_a"] == pytest.approx(result.mean_a_px)
    assert figures["accepted"] is True
    page = picture(scene.cameras, scene.points, result, (np.full((1024, 1024), 90, np.uint8), None))
    assert page.size == (1024, 732)
    colours = np.asarray(page).reshape(-1, 3)
    assert ((colours == (30, 110, 220)).all(axis=1)).any()


def test_scenes_repeat_and_do_not_depend_on_the_noise() -> None:
    assert np.array_equal(EXACT[3].curve_mm, next(s for i, s in enumerate(scenes(4, seed=5)) if i == 3).curve_mm)
    assert np.array_equal(EXACT[3].curve_mm, CLICKED[3].curve_mm)
    for scene in EXACT:
        for camera, points in zip(scene.cameras, scene.points, strict=True):
            assert camera.contains(points).all()
            tip = camera.project(scene.curve_mm[:1])
            assert np.allclose(points[:1], tip)
    spacing = np.linalg.norm(np.diff(scene.curve_mm, axis=0), axis=1)
    assert np.allclose(spacing, 0.25, rtol=1e-6)
    sources = [camera.centre_mm for camera in rig()]
    assert np.linalg.norm(sources[0] - sources[1]) == pytest.approx(1303.0, abs=10.0)
    with pytest.raises(ValueError, match="kind: expected one of arch, hook, loop, shaft"):
        wire("knot", np.random.default_rng(0))


def test_clicks_stay_near_the_curve_and_hold_its_folds() -> None:
    fold = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 1.0], [0.0, 40.0]])
    points = clicked(fold, np.random.default_rng(0), 0.0)
    assert points[:, 0].max() > 97.0
    assert np.array_equal(points[0], fold[0])
    assert distances_to(points, resample(fold, spacing=1.0)).max() < 3.0


def test_a_wire_along_the_epilines_is_said_to_have_no_depth() -> None:
    cameras = rig()
    line = np.stack([np.linspace(30.0, -60.0, 200), np.zeros(200), np.linspace(5.0, -5.0, 200)], axis=1)
    result = reconstruct(*cameras, *(camera.project(line) for camera in cameras))
    assert min(result.tangent_share) == 1.0
    assert any("depth is hardly seen: 100% of the wire" in warning for warning in result.warnings)
