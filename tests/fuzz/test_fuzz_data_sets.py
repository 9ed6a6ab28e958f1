"""The bi-planar data set and X-ray runs: files that are damaged or say nonsense."""

import json
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydicom.uid import RLELossless

from guide3d.dataset.annotation_files import Annotation
from guide3d.dataset.cvat import read_cvat, write_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.dicom.c_arm import camera_of
from guide3d.dicom.header import silent
from guide3d.dicom.run_folder import read_xray
from tests.fuzz.mutations import altered, damaged, rewritten, text_of
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, wire, write_dataset
from tests.guide3d.dicom.written_xray import ENHANCED_XA, PATIENT, enhanced_groups, frames_of, write, xray_dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set and an export of CVAT."""
    folder = tmp_path_factory.mktemp("data_sets")
    write_dataset(folder / "whole", acquisitions=2, frames=2, images=False)
    pairs = [annotation("0-bca-angle-1", number, wire(0.1 * number)) for number in range(3)]
    write_cvat(folder / "cvat.xml", pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})
    return folder


@fuzz(53, 92, 170, 220, 241, 264)
def test_data_sets(rng: random.Random, folder: Path) -> str:
    """A data set opens with finite points and cameras, or is refused."""
    path = folder / "victim"
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(folder / "whole", path)
    victim = rng.choice(sorted(file for file in path.rglob("*") if file.is_file()))
    text = victim.read_text()
    kind = rng.randrange(3)
    if kind == 0:
        victim.write_bytes(damaged(victim.read_bytes(), rng))
    elif victim.suffix == ".json":
        victim.write_text(text_of(altered(json.loads(text), rng), rng), "utf-8", "replace")
    else:
        victim.write_text(rewritten(text, rng), "utf-8", "replace")
    try:
        data = Dataset.open(path)
    except (ValueError, FileNotFoundError) as error:
        return refused(error)
    require_usable([frame.annotation for frame in data.frames])
    for camera in (data.camera_a, data.camera_b):
        numbers = () if camera is None else (camera.K, camera.R, camera.t_mm)
        if not all(np.isfinite(part).all() for part in numbers):
            raise BrokenPromiseError("a camera is not finite")
    return "accepted"


@fuzz()
def test_cvat(rng: random.Random, folder: Path) -> str:
    """An export of CVAT has finite points, or is refused."""
    path = folder / "victim.xml"
    text = (folder / "cvat.xml").read_text()
    changed = rewritten(text, rng) if rng.random() < 0.5 else ""
    path.write_bytes(changed.encode("utf-8", "replace") or damaged(text.encode(), rng))
    try:
        annotations = read_cvat(path, [])
    except (ValueError, FileNotFoundError) as error:
        return refused(error)
    require_usable(annotations)
    return "accepted"


def require_usable(annotations: list[Annotation]) -> None:
    """Refuses points that no picture can have."""
    for one in annotations:
        for points in (one.points_a, one.points_b):
            if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
                raise BrokenPromiseError(f"{one.label} has points of shape {points.shape} that are no pixels")


_VALUES = ("", "0", "-1", "1e300", "7", "65536", "0.4\\0.4", "1\\2\\3", "9" * 16)
_KEYWORDS = ("PositionerPrimaryAngle", "DistanceSourceToDetector", "DistanceSourceToPatient", "ImagerPixelSpacing",
             "NumberOfFrames", "FrameTime", "FrameTimeVector", "PositionerPrimaryAngleIncrement", "WindowWidth",
             "WindowCenter", "FieldOfViewDimensions", "TableHeight")  # fmt: skip
_NUMBERS = ("Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "SamplesPerPixel", "PixelRepresentation")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def test_xray_runs_of_damaged_bytes(rng: random.Random, runs: Path) -> str:
    """A run is read whole, or refused."""
    data = (runs / rng.choice(("plain.dcm", "compressed.dcm", "enhanced.dcm"))).read_bytes()
    for _ in range(rng.choice((1, 3))):
        data = damaged(data, rng)
    path = runs / "victim"
    path.write_bytes(data)
    return verdict(path)


@fuzz(seconds=10)
def test_xray_runs_of_other_values(rng: random.Random, runs: Path) -> str:
    """A run with attributes of other values is read whole, or refused."""
    changed: dict[str, object] = {rng.choice(_KEYWORDS): rng.choice(_VALUES) for _ in range(rng.choice((1, 2)))}
    if rng.random() < 0.4:
        changed[rng.choice(_NUMBERS)] = rng.choice((0, 1, 7, 8, 12, 16, 24, 32, 65535))
    path = runs / "victim"
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
