"""Cameras of a C-arm: projections by hand, the simulator's C-arm, what is missing, mirrored pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")

from guide3d.dicom.c_arm import camera_of, detector_axes, view_warnings
from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from tests.guide3d.dicom.written_xray import frames_of, write, xray_dataset

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
    ("primary", "secondary", "source"),
    [
        (0, 0, BACK),  # the patient faces the detector
        (90, 0, -LEFT),  # LAO: the detector on the left
        (-90, 0, LEFT),
        (0, 90, -HEAD),  # cranial: the detector at the head
        (0, -30, np.cos(np.pi / 6) * BACK + 0.5 * HEAD),
    ],
)
def test_the_source_stands_opposite_the_detector(
    primary: float, secondary: float, source: np.ndarray, run: XrayRun
) -> None:
    assert np.allclose(camera_of(at(run, primary, secondary)).centre_mm, ISOCENTRE * source)


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
        ("source_detector_mm", r"DistanceSourceToDetector \(0018,1110\)"),
        ("source_isocentre_mm", r"DistanceSourceToPatient \(0018,1111\)"),
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
        ("source_detector_mm", [0.0], "isocentre between source and detector"),
        ("source_detector_mm", [100.0], "the detector 100 mm: are the distances in millimetres"),
        ("source_detector_mm", [1.0], "these 300 to 3000 mm apart"),
        ("primary_deg", [181.0], "primary angle from -180 to 180"),
        ("secondary_deg", [-91.0], "secondary one from -90 to 90"),
        ("source_detector_mm", [1e300], "300 to 3000 mm apart"),
        ("pixel_mm", [[0.2, 0.0]], "pixel spacing from 0.001 to 100 mm"),
        ("pixel_mm", [[1e-300, 1e-300]], "pixel spacing from 0.001 to 100 mm"),
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
