"""Real X-ray images of a wire in a phantom, where they are: loose limits of what is reached on them.

Calibration by the cube, reading by the shipped reader, reconstruction of annotated pairs.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.guide3d.reconstruction import of_pairs
from guide3d.calibration import cube_calibration, folder
from guide3d.calibration.__main__ import figures
from guide3d.calibration.cube_calibration import calibrate_folder
from guide3d.calibration.perforated_sheet import SheetHoles, find_holes
from guide3d.geometry.camera import read_camera
from pipeline.protocol import calibration as calibration_claim
from pipeline.protocol.claims import read_protocol
from pipeline.protocol.run import KINDS, summary
from tests.guide3d.real_images import real_folder, write_some_pairs

KEPT: dict[bytes, SheetHoles] = {}  # by image: the search takes seconds, and all of these tests want it


def found_once(image: np.ndarray) -> SheetHoles:
    key = image.tobytes()
    if key not in KEPT:
        KEPT[key] = find_holes(image)
    return KEPT[key]


@pytest.fixture(autouse=True)
def data(monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of data is that of the real images."""
    folder_of_data = real_folder()
    monkeypatch.setenv("ENDONAV_DATA", str(folder_of_data))
    for module in (cube_calibration, folder):
        monkeypatch.setattr(module, "find_holes", found_once)
    return folder_of_data


def test_pairs_are_read_near_their_figures() -> None:
    claim = read_protocol().claims["real_xray"]
    cases = [case for case in KINDS[claim.kind].cases(claim, 0) if case["variation"] == "size 1"]
    found = summary([case | KINDS[claim.kind].play(claim, case) for case in cases])
    assert found["cases"] == 6
    assert found["success_pct"]["mean"] == 100
    assert found["dice_mean"]["mean"] > 0.85
    assert found["within_4px_pct_mean"]["mean"] > 97
    assert found["tip_px_mean"]["mean"] < 8
    assert found["mean_mm_mean"]["mean"] < 1.0
    assert found["tip_mm_mean"]["mean"] < 3.0


def test_pairs_reconstruct_within_their_pixels_as_they_are_given(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = of_pairs(write_some_pairs(tmp_path), data / "xray_calibration", None, as_given=True)
    assert report["annotations"] == report["cameras"] == "as given"
    assert max(report["mean_px_a"], report["mean_px_b"]) < 0.8
    assert report["coverage"] > 0.97
    assert "tips miss each other's epilines" in capsys.readouterr().out  # for they are raw


def test_pairs_are_raw_and_reconstruct_within_their_pixels(data: Path, tmp_path: Path) -> None:
    report = of_pairs(write_some_pairs(tmp_path), data / "xray_calibration", None, as_given=False)
    assert report["annotations"] == "raw"
    assert report["cameras"] == "as given"
    assert max(report["mean_px_a"], report["mean_px_b"]) < 0.5
    assert report["coverage"] > 0.97


def test_a_cube_calibrates_the_rig(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calibration = calibrate_folder(data / "xray_calibration")
    numbers = figures(calibration)
    monkeypatch.setattr(calibration_claim, "_figures", lambda: numbers)
    found = [calibration_claim.play(None, case) for case in calibration_claim.cases(None, 0)]
    assert [one["beads"] > 25 and one["mean_px"] < 0.6 and one["leave_out_px"] < 0.2 for one in found] == [True, True]
    assert calibration.warnings == []
    for detector, holes, beads in (("16709", 4945, 29), ("16710", 4700, 39)):
        own = numbers[detector]
        assert own["holes"] >= holes
        assert own["leave_out_px"] < 0.15
        assert own["images"]["calibration1"]["beads"] == beads
        assert own["images"]["calibration1"]["mean_px"] < 0.45
    # the detectors stand to each other as the group calibrated them in January, to what one pose of the cube can tell
    a, b = (calibration.rig.cameras[detector] for detector in ("16710", "16709"))
    A, B = (
        read_camera(data / f"xray_calibration/projection_2024-01-18_{detector}.txt") for detector in ("16710", "16709")
    )
    turn = (b.R @ a.R.T) @ (B.R @ A.R.T).T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 8.0
    apart, then = np.linalg.norm(a.centre_mm - b.centre_mm), np.linalg.norm(A.centre_mm - B.centre_mm)
    assert apart == pytest.approx(then, rel=0.05)
    # the wire marks lie beside the beads that bear them
    marks = {mark.kind: mark for mark in calibration.views["calibration1", "16710"].marks}
    for kind, bead in (("circle", 21), ("double", 25), ("single", 38)):
        place = calibration.distortions["16710"].distort_points(a.project(calibration.points_mm[bead]))
        assert np.linalg.norm(marks[kind].pixels - place, axis=1).min() < 40
