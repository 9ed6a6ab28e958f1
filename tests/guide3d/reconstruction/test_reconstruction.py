"""Wires in space from two annotated views, records of their errors; swapped cameras and raw annotations are told."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.guide3d.reconstruction import of_pairs
from guide3d.geometry.camera import write_camera
from guide3d.geometry.metrics import max_ed, mers, mete
from guide3d.geometry.polyline import arc_length, at_length, distances_to, resample
from guide3d.native_library import HOME, library, sources_digest
from guide3d.reconstruction.evaluation import (
    METRICS,
    PLACES,
    accepted,
    evaluate_pair,
    profile_summary,
    reprojection_summary,
    truth_summary,
)
from guide3d.reconstruction.matching import Match, complete
from guide3d.reconstruction.reconstruction import Reconstruction, reconstruct
from guide3d.reconstruction.synthetic_scene import KINDS, SyntheticScene, rig, scenes, wire
from guide3d.reconstruction.view_checks import swapped_cameras, undistorted_or_raw

EXACT = list(scenes(16, seed=5))
CLICKED = list(scenes(40, seed=5, noise_px=1.0))


def of(scene: SyntheticScene) -> Reconstruction:
    return reconstruct(*scene.cameras, *scene.points)


def test_the_native_code_is_that_of_the_sources() -> None:
    assert library().guide3d_sources().decode() == sources_digest(HOME / "native")


@pytest.mark.parametrize("kind", KINDS)
def test_exact_annotations_give_the_wire_back(kind: str) -> None:
    group = [scene for scene in EXACT if scene.kind == kind]
    errors = [
        (r := of(scene)) and (max_ed(r.curve_mm, scene.curve_mm), mete(r.curve_mm, scene.curve_mm)) for scene in group
    ]
    for scene in group[:2]:  # the spline is the curve, and not longer
        result = of(scene)
        spline = result.spline.sample(4000)
        assert arc_length(spline)[-1] == pytest.approx(result.length_mm, abs=0.6)  # the points' distance is 0.5 mm
        assert distances_to(spline, result.curve_mm).max() < 0.01
    assert np.mean(errors, axis=0)[0] < 0.3
    assert np.max(errors, axis=0)[1] < 0.05


def test_clicks_with_noise_give_the_wire_within_its_own_uncertainty() -> None:
    means, tips, inside, noises = [], [], [], []
    for scene in CLICKED:
        result = of(scene)
        means.append(mers(result.curve_mm, scene.curve_mm))
        tips.append(mete(result.curve_mm, scene.curve_mm))
        noises.append(result.noise_px)
        length = min(result.length_mm, arc_length(scene.curve_mm)[-1])
        count = int(length / 0.5) + 1
        off = result.curve_mm[:count] - at_length(scene.curve_mm, 0.5 * np.arange(count))
        squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(result.covariance_mm2[:count]), off)
        inside.append(np.mean(squares < chi2.ppf(0.95, 3)))
    assert np.mean(means) < 0.5
    assert np.mean(tips) < 0.4
    assert np.mean(noises) == pytest.approx(1.0, abs=0.05)
    assert 0.85 < np.mean(inside) < 0.97


def test_the_standard_deviation_is_that_of_repeated_clicks() -> None:
    scene = next(scene for scene in EXACT if scene.kind == "shaft")
    draws = np.random.default_rng(0)
    repeated = []
    for _ in range(16):
        clicks = [points + draws.normal(0.0, 1.0, points.shape) for points in scene.points]
        repeated.append(reconstruct(*scene.cameras, *clicks))
    count = min(len(one.curve_mm) for one in repeated)
    spread = np.sqrt(np.var([one.curve_mm[:count] for one in repeated], axis=0, ddof=1).sum(axis=1))
    told = np.mean([one.sd_mm[:count] for one in repeated], axis=0)
    assert 0.6 < np.median(told / spread) < 1.6


def test_a_bad_reprojection_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    assert of(CLICKED[0]).accepted
    monkeypatch.setattr("guide3d.reconstruction.reconstruction.REJECTION_PX", 0.01)
    result = of(CLICKED[0])
    assert not result.accepted
    assert any("rejected" in warning for warning in result.warnings)


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


def test_gaps_are_completed_between_measured_pairs_and_no_further() -> None:
    line = np.stack([np.arange(0.0, 100.0, 2.0), np.zeros(50)], axis=1)
    along = np.arange(0.0, 80.0, 2.0)
    stalled = along.copy()
    stalled[15:25] = stalled[15]  # a path that stood still and jumped, with nothing measured
    measured = np.ones(40, dtype=bool)
    measured[16:25] = False
    measured[-2:] = False
    match = Match(along, stalled, line[:40], line[:40], measured, 98.0, 98.0, 0.0)
    done = complete(match, line, line, 2.0)
    assert np.abs(done.along_b - done.along_a).max() < 1.0
    assert np.array_equal(done.along_b[-2:], stalled[-2:])
    assert np.allclose(done.points_b[:, 0], done.along_b)
    assert done.covered("a") == pytest.approx((30.0 + 24.0) / 98.0)


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
    with pytest.raises(ValueError, match=r"annotation of camera A: point 0 at .* lies outside the image"):
        reconstruct(*scene.cameras, a + np.array([3000.0, 0.0]), b)
    with pytest.raises(ValueError, match="annotation of camera A: expected a curve of at least"):
        reconstruct(*scene.cameras, a[:1] + np.array([[0.0, 0.0], [1.0, 0.0]]), b)
    with pytest.raises(ValueError, match="no stretch in common"):
        reconstruct(*scene.cameras, a * [1.0, 0.1], 1000.0 - b * [1.0, 0.1])
    for unit in (10.0, 1000.0):  # cm, m
        others = [replace(camera, t_mm=camera.t_mm / unit) for camera in scene.cameras]
        with pytest.raises(ValueError, match="is the cameras' unit of length another one"):
            reconstruct(*others, a, b)


def test_a_wire_along_the_epilines_is_said_to_have_no_depth() -> None:
    cameras = rig()
    line = np.stack([np.linspace(30.0, -60.0, 200), np.zeros(200), np.linspace(5.0, -5.0, 200)], axis=1)
    result = reconstruct(*cameras, *(camera.project(line) for camera in cameras))
    assert min(result.tangent_share) == 1.0
    assert any("depth is hardly seen: 100% of the wire" in warning for warning in result.warnings)


@pytest.fixture(scope="module")
def evaluation_scene():
    return next(iter(scenes(1, seed=0, noise_px=0.0)))


@pytest.mark.parametrize("greedy", [False, True])
def test_a_record_holds_the_errors_in_the_images_and_of_the_truth(evaluation_scene, greedy: bool) -> None:
    scene = evaluation_scene
    record = evaluate_pair(*scene.cameras, *scene.points, scene.curve_mm, greedy=greedy)
    assert record["accepted"]
    assert max(record["mean_a_px"], record["mean_b_px"]) < (3.0 if greedy else 0.3)
    assert len(record["along_a_px"]) == len(record["along_mm"]) == PLACES
    assert np.mean(record["along_mm"]) == pytest.approx(record["mers"], abs=0.3)
    assert abs(record["length_error_mm"]) < 5.0
    assert set(record["curve"]) == {"tck", "u"}
    summary = truth_summary([record, record])
    assert summary["mers"] == [pytest.approx(record["mers"]), 0.0]
    assert set(summary) == {*METRICS, "length_error", "n"}
    assert "mers" not in evaluate_pair(*scene.cameras, *scene.points, greedy=greedy)


def test_a_pair_with_nothing_in_common_is_a_record_with_the_reason(evaluation_scene) -> None:
    away = [evaluation_scene.points[0], evaluation_scene.points[1] * [0.0, 0.05] + [3.0, 0.0]]
    record = evaluate_pair(*evaluation_scene.cameras, *away, greedy=True)
    assert not record["accepted"]
    assert "in common" in record["reason"]
    good = evaluate_pair(*evaluation_scene.cameras, *evaluation_scene.points, greedy=True)
    assert accepted([record, good]) == [good]
    assert reprojection_summary([record]) == {"accepted_pct": 0.0, "n": 1}
    both = reprojection_summary([record, good])
    assert both["accepted_pct"] == 50.0
    assert both["mean_a"] == [good["mean_a_px"], 0.0]


def test_a_profile_is_summed_up_at_the_tip_the_peak_and_the_ends() -> None:
    summary = profile_summary([[1.0, 5.0, 2.0], [3.0, 5.0, 2.0]])
    assert summary == {"distal_mean": 2.0, "peak_mean": 5.0, "std_start": 1.0, "std_end": 0.0, "n": 2}


def barrel(points: np.ndarray) -> np.ndarray:
    off = points - 511.5
    return 511.5 + off * (1.0 - 6e-8 * (off**2).sum(1, keepdims=True)) @ np.array([[1.0, 0.02], [-0.02, 1.0]])


def unbarrel(points: np.ndarray) -> np.ndarray:
    guess = points.copy()
    for _ in range(20):
        guess += points - barrel(guess)
    return guess


def common_rig() -> tuple[tuple, list[tuple[np.ndarray, np.ndarray]]]:
    cameras, rng = rig(np.random.default_rng(2)), np.random.default_rng(3)
    pairs = []
    while len(pairs) < 8:
        curve = wire("arch", rng) + np.array([25.0, 0.0, 0.0])
        images = [camera.project(curve[:480]) for camera in cameras]
        if all(camera.contains(image).all() for camera, image in zip(cameras, images, strict=True)):
            pairs.append((images[0], images[1]))
    return cameras, pairs


def test_swapped_cameras_are_told_over_a_set() -> None:
    cameras, pairs = common_rig()
    right, wrong = swapped_cameras(*cameras, pairs), swapped_cameras(*cameras[::-1], pairs)
    assert (right.answer, right.sure) == ("as given", True)
    assert (wrong.answer, wrong.sure) == ("swapped", True)
    assert "the cameras are swapped: epipolar residual" in wrong.sentence
    with pytest.raises(ValueError, match="at least one pair"):
        swapped_cameras(*cameras, [])


def test_raw_annotations_are_told_from_undistorted_ones() -> None:
    cameras, pairs = common_rig()
    raw = [(barrel(a), unbarrel(b)) for a, b in pairs]  # both views distorted, differently
    found = undistorted_or_raw(*cameras, raw, unbarrel, barrel)
    assert found.answer == "raw"
    assert found.residual_px < 0.4 < 0.6 < found.other_px
    assert undistorted_or_raw(*cameras, pairs, unbarrel, barrel).answer == "undistorted"


def write_rig(folder: Path) -> Path:
    cameras, pairs = common_rig()
    for camera, detector in zip(cameras, ("16710", "16709"), strict=True):
        write_camera(camera, folder / f"projection_{detector}.txt")
    listed = [{"pair": k, "camera_a": a.tolist(), "camera_b": b.tolist()} for k, (a, b) in enumerate(pairs[:3])]
    path = folder / "pairs.json"
    path.write_text(json.dumps({"units": "px", "pairs": listed}))
    return path


def test_the_benchmark_reports_a_file_of_pairs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = of_pairs(write_rig(tmp_path), tmp_path, tmp_path / "pictures", as_given=False)
    assert report["mean_px_a"] < 0.1
    assert report["mean_px_b"] < 0.1
    assert report["coverage"] > 0.97
    assert [line["pair"] for line in report["per_pair"]] == [0, 1, 2]
    assert report["pairs_per_s"] > 5
    assert "the cameras are as given" in capsys.readouterr().out
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 3
