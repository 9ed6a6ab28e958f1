"""Swapped cameras and raw annotations, found by epipolar residuals on synthetic scenes and on real pairs."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guide3d.reconstruction.synthetic_scene import rig, wire
from guide3d.reconstruction.view_checks import swapped_cameras, undistorted_or_raw

ROOT = Path(__file__).resolve().parents[3]
REAL = ROOT.parent / "shared" / "real"
BENCHMARK = ROOT / "benchmarks" / "guide3d" / "reconstruction.py"


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


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(BENCHMARK), *arguments], capture_output=True, text=True, check=False)


def write_rig(folder: Path, count: int = 2) -> Path:
    from guide3d.geometry.camera import write_camera

    cameras, pairs = common_rig()
    for camera, detector in list(zip(cameras, ("16710", "16709"), strict=True))[:count]:
        write_camera(camera, folder / f"projection_{detector}.txt")
    listed = [{"pair": k, "camera_a": a.tolist(), "camera_b": b.tolist()} for k, (a, b) in enumerate(pairs[:3])]
    path = folder / "pairs.json"
    path.write_text(json.dumps({"units": "px", "pairs": listed}))
    return path


def test_the_benchmark_reports_a_file_of_pairs(tmp_path: Path) -> None:
    done = run(str(write_rig(tmp_path)), "--cameras", str(tmp_path), "--pictures", str(tmp_path / "pictures"))
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["mean_px_a"] < 0.1
    assert report["mean_px_b"] < 0.1
    assert report["coverage"] > 0.97
    assert [line["pair"] for line in report["per_pair"]] == [0, 1, 2]
    assert report["pairs_per_s"] > 5
    assert "the cameras are as given" in done.stdout
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 3


real = pytest.mark.skipif(not (REAL / "stereo_pairs.json").is_file(), reason="the real stereo pairs are not there")


@pytest.fixture
def some_pairs(tmp_path: Path) -> str:
    """Every second of the real pairs."""
    told = json.loads((REAL / "stereo_pairs.json").read_text())
    (tmp_path / "pairs.json").write_text(json.dumps(told | {"pairs": told["pairs"][::2]}))
    return str(tmp_path / "pairs.json")


@real
def test_real_pairs_reconstruct_within_their_pixels_as_they_are_given(some_pairs: str) -> None:
    done = run(some_pairs, "--cameras", str(REAL / "xray_calibration"), "--as-given")
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["annotations"] == report["cameras"] == "as given"
    assert max(report["mean_px_a"], report["mean_px_b"]) < 0.8
    assert report["coverage"] > 0.97
    assert "tips miss each other's epilines" in done.stdout  # for they are raw


@real
@pytest.mark.slow
def test_real_pairs_are_raw_and_reconstruct_within_their_pixels(some_pairs: str) -> None:
    done = run(some_pairs, "--cameras", str(REAL / "xray_calibration"))
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["annotations"] == "raw"
    assert report["cameras"] == "as given"
    assert max(report["mean_px_a"], report["mean_px_b"]) < 0.5
    assert report["coverage"] > 0.97
