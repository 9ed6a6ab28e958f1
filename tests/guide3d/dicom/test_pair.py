"""Two runs: images and cameras to a curve in space, what does not go together, and the command line."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from guide3d import reconstruct
from guide3d.calibration.folder import cameras_in
from guide3d.dicom import images_and_cameras
from guide3d.dicom.__main__ import main
from tests.guide3d.dicom.written_xray import (
    ENHANCED_XA,
    PATIENT,
    enhanced_groups,
    frames_of,
    write,
    xray_dataset,
)

pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")


ANGLES_B = {"PositionerPrimaryAngle": "-60", "PositionerSecondaryAngle": "5"}


def file_of(path: Path, count: int = 2, side: int = 64, **changed: Any) -> Path:
    values: dict[str, Any] = {"ImagerPixelSpacing": ["0.2", "0.2"], "FrameTime": "50", **changed}
    return write(xray_dataset(frames_of(count, side, side), **values), path)


def test_both_files_give_a_curve_in_space(tmp_path: Path) -> None:
    a = file_of(tmp_path / "a.dcm", 1, 1024)
    b = file_of(tmp_path / "b.dcm", 1, 1024, **ANGLES_B)
    pair = images_and_cameras(a, b)
    assert pair.images_a.shape == (1, 1024, 1024)
    assert not pair.warnings
    s = np.linspace(0, 1, 5000)[:, None]
    curve = np.hstack([20 * np.sin(3 * s), 30 * s * s - 15, 60 * s - 30])
    camera_a, camera_b = pair.cameras_a[0], pair.cameras_b[0]
    wire = reconstruct(camera_a, camera_b, camera_a.project(curve[::25]), camera_b.project(curve[::25]))
    assert wire.accepted
    assert not wire.warnings
    off, _ = cKDTree(curve).query(wire.curve_mm)
    assert off.max() < 0.05


def test_the_longer_run_is_cut_and_tables_are_compared(tmp_path: Path) -> None:
    a = file_of(tmp_path / "a.dcm", 4, TableHeight="100")
    b = file_of(tmp_path / "b.dcm", 3, TableHeight="140", **ANGLES_B)
    pair = images_and_cameras(a, b)
    assert len(pair.images_a) == len(pair.images_b) == len(pair.cameras_a) == 3
    assert np.allclose(pair.times_ms, [0, 50, 100])
    assert any("4 and 3 frames" in warning for warning in pair.warnings)
    assert any("40 mm apart" in warning for warning in pair.warnings)


def test_enhanced_runs_have_a_camera_for_each_frame(tmp_path: Path) -> None:
    paths = []
    for name, angles in (("a", [0.0, 10.0, 20.0]), ("b", [90.0, 100.0, 110.0])):
        dataset = xray_dataset(frames_of(3), kind=ENHANCED_XA, **enhanced_groups(angles))
        paths.append(write(dataset, tmp_path / f"{name}.dcm"))
    pair = images_and_cameras(*paths)
    centres = np.array([camera.centre_mm for camera in pair.cameras_a])
    expected = 750 * np.array([[-np.sin(p), np.cos(p), 0] for p in np.radians([0, 10, 20])])
    assert np.allclose(centres, expected)


def test_the_command_writes_what_reading_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = file_of(tmp_path / "a.dcm"), file_of(tmp_path / "b.dcm", **ANGLES_B)
    out = tmp_path / "out"
    assert main([str(a), str(b), "--output", str(out)]) == 0
    assert "a: 2 frames of 64 x 64 px, primary 30.0 and secondary -20.0 degrees" in capsys.readouterr().out
    pair = images_and_cameras(a, b)
    found = cameras_in(out)
    for camera, expected in zip(found, (pair.cameras_a[0], pair.cameras_b[0]), strict=True):
        assert np.allclose(camera.P, expected.P)
    for view, images in (("a", pair.images_a), ("b", pair.images_b)):
        for number, image in enumerate(images):
            written = cv2.imread(str(out / view / f"{number:03d}.png"), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(written, image)
    runs = json.loads((out / "runs.json").read_text())
    assert runs["b"]["primary_deg"] == [-60, -60]
    assert runs["a"]["table_mm"] == 2 * [[None, None, None]]
    for path in out.rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            assert not [value for value in PATIENT.values() if value.encode() in data]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("{a}", "{none}"), "needs PositionerPrimaryAngle (0018,1510), which the file does not have"),
        (("{a}", "{gone}"), "is missing"),
        (("{a}", "{cut}"), "damaged or truncated"),
        (("{turning}",), "add --frame N"),
        (("{a}", "--frame", "7"), "expected a frame from 0 to 1, found 7"),
        (("{a}", "--frame", "-1"), "expected a frame from 0 to 1, found -1"),
    ],
)
def test_a_refusal_is_one_sentence_and_leaves_nothing(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {
        "a": file_of(tmp_path / "a.dcm"),
        "none": file_of(tmp_path / "none.dcm", PositionerPrimaryAngle=None),
        "turning": file_of(tmp_path / "turning.dcm", PositionerPrimaryAngleIncrement="2"),
        "gone": tmp_path / "gone.dcm",
        "cut": tmp_path / "cut.dcm",
    }
    files["cut"].write_bytes(files["a"].read_bytes()[:-500])
    out = tmp_path / "out"
    assert main([*(word.format(**files) for word in words), "--output", str(out)]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_different_frame_rates_are_said(tmp_path: Path) -> None:
    a = file_of(tmp_path / "a.dcm", 4)
    pair = images_and_cameras(a, file_of(tmp_path / "b.dcm", 4, FrameTime="100", **ANGLES_B))
    assert any("frames of one number are up to 150 ms apart" in warning for warning in pair.warnings)
    pair = images_and_cameras(a, file_of(tmp_path / "c.dcm", 4, FrameTime="50.2", **ANGLES_B))
    assert not pair.warnings


@pytest.mark.parametrize("primary", ["30", "-150"])
def test_two_views_along_one_line_are_refused(primary: str, tmp_path: Path) -> None:
    secondary = "-20" if primary == "30" else "20"
    a, b = file_of(tmp_path / "a.dcm"), file_of(
        tmp_path / "b.dcm", PositionerPrimaryAngle=primary, PositionerSecondaryAngle=secondary
    )  # fmt: skip
    with pytest.raises(ValueError, match="look along one line"):
        images_and_cameras(a, b)


def test_a_table_that_moves_is_said(tmp_path: Path) -> None:
    a = file_of(tmp_path / "a.dcm", 2, TableLongitudinalIncrement=["0", "12"])
    pair = images_and_cameras(a, file_of(tmp_path / "b.dcm", 2, **ANGLES_B))
    assert any("a.dcm: the table moves by 12 mm" in warning for warning in pair.warnings)
