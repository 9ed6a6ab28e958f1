"""Cameras of a C-arm, by hand and against the simulator's; two runs to a curve in space, and the command line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")

from guide3d import reconstruct
from guide3d.calibration.folder import cameras_in
from guide3d.dicom.__main__ import main
from guide3d.dicom.c_arm import camera_of, detector_axes, view_warnings
from guide3d.dicom.pair import images_and_cameras
from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from tests.guide3d.dicom.written_xray import ENHANCED_XA, PATIENT, enhanced_groups, frames_of, write, xray_dataset

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
    moving = file_of(tmp_path / "moving.dcm", 2, TableLongitudinalIncrement=["0", "12"])
    assert any("moving.dcm: the table moves by 12 mm" in said for said in images_and_cameras(moving, b).warnings)
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


LEFT, BACK, HEAD = np.eye(3)
SPACING, DETECTOR, ISOCENTRE = 0.25, 1000.0, 800.0


@pytest.fixture
def run(tmp_path: Path) -> XrayRun:
    geometry = {
        "PositionerPrimaryAngle": "0",
        "PositionerSecondaryAngle": "0",
        "DistanceSourceToDetector": str(DETECTOR),
        "DistanceSourceToPatient": str(ISOCENTRE),
        "ImagerPixelSpacing": [str(SPACING), str(SPACING)],
    }
    return read_xray(write(xray_dataset(frames_of(1, 101, 101), **geometry), tmp_path / "run.dcm"))


def at(run: XrayRun, primary: float, secondary: float) -> XrayRun:
    return replace(run, primary_deg=np.array([primary]), secondary_deg=np.array([secondary]))


@pytest.mark.parametrize(
    ("primary", "secondary", "point", "expected"),
    [
        # 10 mm beside the isocentre are 12.5 mm on the detector, 50 px
        (0, 0, 0 * LEFT, (50, 50)),
        (0, 0, 10 * LEFT, (100, 50)),
        (0, 0, 10 * HEAD, (50, 0)),
        (90, 0, 10 * BACK, (100, 50)),  # seen from the left the back is on the right
        (90, 0, 10 * HEAD, (50, 0)),
        (-90, 0, 10 * BACK, (0, 50)),
        (0, 0, 10 * LEFT - 200 * BACK, (50 + 40, 50)),  # at the detector: 10 mm are 10 mm
        (0, 0, 10 * LEFT + 300 * BACK, (50 + 80, 50)),  # towards the source: 20 mm
        (0, 30, -10 * BACK, (50, 50 + 10 * 0.5 * 1000 / (800 + 10 * np.sqrt(0.75)) / 0.25)),  # the chest moves down
        (30, 0, -10 * BACK, (50 + -10 * -0.5 * -1 * 1000 / (800 + 10 * np.sqrt(0.75)) / 0.25, 50)),
    ],
)
def test_projections_by_hand(
    primary: float, secondary: float, point: np.ndarray, expected: tuple[float, float], run: XrayRun
) -> None:
    assert np.allclose(camera_of(at(run, primary, secondary)).project(point), expected)


def test_rows_and_columns_have_their_own_spacing(run: XrayRun) -> None:
    camera = camera_of(replace(run, pixel_mm=np.array([[0.5, 0.2]])))
    assert np.allclose(camera.project(10 * LEFT + 10 * HEAD), [50 + 12.5 / 0.5, 50 - 12.5 / 0.2])
    assert (camera.width, camera.height) == (101, 101)


@pytest.mark.parametrize(("primary", "secondary"), [(0, 0), (45, 0), (-30, 20), (90, 0), (120, -35)])
def test_it_is_the_simulators_view_from_the_other_side(primary: float, secondary: float, run: XrayRun) -> None:
    projector = pytest.importorskip("cathsim.fluoroscopy.projector").Projector.c_arm(
        centre=np.zeros(3),
        field_of_view=1e-3 * 101 * SPACING * ISOCENTRE / DETECTOR,
        size=101,
        primary_deg=primary,
        secondary_deg=secondary,
        source_detector_distance=1e-3 * DETECTOR,
        source_object_distance=1e-3 * ISOCENTRE,
    )
    points = np.random.default_rng(0).normal(scale=40.0, size=(50, 3))
    ahead = detector_axes(primary, secondary)[2]
    # there the source stands where the detector stands here: the depth is the other way round, all else the same
    mirrored = points - 2 * (points @ ahead)[:, None] * ahead
    seen = camera_of(at(run, primary, secondary)).project(points)
    assert np.allclose(seen, projector.project(1e-3 * mirrored))


@pytest.mark.parametrize(
    ("field", "name"),
    [
        ("primary_deg", r"PositionerPrimaryAngle \(0018,1510\)"),
        ("secondary_deg", r"PositionerSecondaryAngle \(0018,1511\)"),
        ("pixel_mm", r"ImagerPixelSpacing \(0018,1164\)"),
    ],
)
def test_what_is_missing_is_named(field: str, name: str, run: XrayRun) -> None:
    with pytest.raises(ValueError, match=rf"run.dcm: a camera needs {name}, which the file does not have"):
        camera_of(replace(run, **{field: np.full_like(getattr(run, field), np.nan)}))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("source_isocentre_mm", [1200.0], "isocentre between source and detector"),
        ("source_detector_mm", [100.0], "the detector 100 mm"),
        ("primary_deg", [181.0], "primary angle from -180 to 180"),
        ("secondary_deg", [-91.0], "secondary one from -90 to 90"),
        ("source_detector_mm", [1e300], "300 to 3000 mm apart"),
        ("pixel_mm", [[0.2, 0.0]], "pixel spacing from 0.001 to 100 mm"),
        ("pixel_mm", [[0.2, 1e300]], "pixel spacing from 0.001 to 100 mm"),
    ],
)
def test_impossible_geometry_is_refused(field: str, value: list, said: str, run: XrayRun) -> None:
    with pytest.raises(ValueError, match=said):
        camera_of(replace(run, **{field: np.array(value)}))
    with pytest.raises(IndexError, match="expected a frame from 0 to 0, found 1"):
        camera_of(run, 1)


def test_mirrored_pictures_and_tilted_beams_are_said(run: XrayRun) -> None:
    assert not view_warnings(replace(run, orientation=("L", "F")))
    assert not view_warnings(replace(at(run, 90, 0), orientation=("L", "F")))  # across the picture: says nothing
    assert "rows run away from the side R" in view_warnings(replace(run, orientation=("R", "F")))[0]
    assert "columns run away from the side H" in view_warnings(replace(run, orientation=("L", "H")))[0]
    assert "2.0 degrees askew" in view_warnings(replace(run, beam_tilt_deg=2.0))[0]
