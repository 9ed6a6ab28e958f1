"""X-ray runs: plain, enhanced and compressed DICOM files, damaged or with attributes of other values."""

import random
from pathlib import Path

import numpy as np
import pytest
from pydicom.uid import RLELossless

from guide3d.dicom.c_arm import camera_of
from guide3d.dicom.header import silent
from guide3d.dicom.run_folder import read_xray
from tests.fuzz.mutations import damaged
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.guide3d.dicom.written_xray import ENHANCED_XA, PATIENT, enhanced_groups, frames_of, write, xray_dataset

_VALUES = ("", "0", "-1", "1e300", "7", "65536", "0.4\\0.4", "1\\2\\3", "9" * 16)
_KEYWORDS = ("PositionerPrimaryAngle", "DistanceSourceToDetector", "DistanceSourceToPatient", "ImagerPixelSpacing",
             "NumberOfFrames", "FrameTime", "FrameTimeVector", "PositionerPrimaryAngleIncrement", "WindowWidth",
             "WindowCenter", "FieldOfViewDimensions", "TableHeight")  # fmt: skip
_NUMBERS = ("Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "SamplesPerPixel", "PixelRepresentation")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain, a compressed and an enhanced run."""
    folder = tmp_path_factory.mktemp("xray_runs")
    window = {"WindowCenter": "128", "WindowWidth": "200", "FrameTime": "50"}
    compressed = xray_dataset(frames_of(2, 20, 24, 10), 10, **window)
    compressed.compress(RLELossless)
    enhanced = xray_dataset(frames_of(2, 20, 24), kind=ENHANCED_XA, **enhanced_groups([0.0, 5.0]))
    write(xray_dataset(frames_of(3, 20, 24), **window), folder / "plain.dcm")
    write(compressed, folder / "compressed.dcm")
    write(enhanced, folder / "enhanced.dcm")
    return folder


@fuzz(seconds=10)
def test_xray_runs_of_damaged_bytes(rng: random.Random, folder: Path) -> str:
    """A run is read whole, or refused."""
    data = (folder / rng.choice(("plain.dcm", "compressed.dcm", "enhanced.dcm"))).read_bytes()
    for _ in range(rng.choice((1, 3))):
        data = damaged(data, rng)
    path = folder / "victim"
    path.write_bytes(data)
    return verdict(path)


@fuzz(seconds=10)
def test_xray_runs_of_other_values(rng: random.Random, folder: Path) -> str:
    """A run with attributes of other values is read whole, or refused."""
    changed: dict[str, object] = {rng.choice(_KEYWORDS): rng.choice(_VALUES) for _ in range(rng.choice((1, 2)))}
    if rng.random() < 0.4:
        changed[rng.choice(_NUMBERS)] = rng.choice((0, 1, 7, 8, 12, 16, 24, 32, 65535))
    path = folder / "victim"
    try:
        with silent():  # pydicom warns of values that it writes all the same
            write(xray_dataset(frames_of(3, 20, 24), **changed), path)
    except (ValueError, TypeError, OverflowError):  # pydicom itself does not write it
        return "refused"
    return verdict(path)


def verdict(path: Path) -> str:
    """As many pictures as the run says, and cameras, or a refusal without a word of the patient."""
    try:
        run = read_xray(path)
        if not len(run) == len(run.images()) == len(run.primary_deg):
            raise BrokenPromiseError("a run has other numbers of frames and pictures")
        cameras = [camera_of(run, frame) for frame in range(len(run))]
    except ValueError as error:
        if any(value in str(error) for value in PATIENT.values()):
            raise BrokenPromiseError("a refusal quotes the patient") from error
        return refused(error)
    if not all(np.isfinite(camera.P).all() for camera in cameras):
        raise BrokenPromiseError("a camera is not finite")
    return "accepted"
