"""X-ray runs: plain, enhanced and compressed DICOM files, damaged or with attributes of other values."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from pydicom.uid import RLELossless

from guide3d.dicom.c_arm import camera_of
from guide3d.dicom.header import silent
from guide3d.dicom.xray_run import read_xray
from tests.fuzz.mutations import damaged
from tests.fuzz.target import Target, WrongError, refused
from tests.guide3d.dicom.written_xray import ENHANCED_XA, PATIENT, enhanced_groups, frames_of, write, xray_dataset

_VALUES = ("", "0", "-1", "1e300", "7", "65536", "0.4\\0.4", "1\\2\\3", "9" * 16)
_KEYWORDS = ("PositionerPrimaryAngle", "DistanceSourceToDetector", "DistanceSourceToPatient", "ImagerPixelSpacing",
             "NumberOfFrames", "FrameTime", "FrameTimeVector", "PositionerPrimaryAngleIncrement", "WindowWidth",
             "WindowCenter", "FieldOfViewDimensions", "TableHeight")  # fmt: skip
_NUMBERS = ("Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "SamplesPerPixel", "PixelRepresentation")


class DicomTarget(Target):
    """Reading: a run, as many pictures as it says and cameras or a refusal; never a word of the patient."""

    name = "dicom"
    seconds = 10.0

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        window = {"WindowCenter": "128", "WindowWidth": "200", "FrameTime": "50"}
        plain = xray_dataset(frames_of(3, 20, 24), **window)
        deep = xray_dataset(frames_of(2, 20, 24, 10), 10, **window)
        deep.compress(RLELossless)
        enhanced = xray_dataset(frames_of(2, 20, 24), kind=ENHANCED_XA, **enhanced_groups([0.0, 5.0]))
        paths = [write(dataset, folder / f"{k}.dcm") for k, dataset in enumerate((plain, deep, enhanced))]
        self.data = [path.read_bytes() for path in paths]

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        path = self.folder / "victim.dcm"
        if rng.random() < 0.6:
            data = rng.choice(self.data)
            for _ in range(rng.choice((1, 3))):
                data = damaged(data, rng)
            path.write_bytes(data)
        else:
            changed: dict[str, object] = {rng.choice(_KEYWORDS): rng.choice(_VALUES) for _ in range(rng.choice((1, 2)))}
            if rng.random() < 0.4:
                changed[rng.choice(_NUMBERS)] = rng.choice((0, 1, 7, 8, 12, 16, 24, 32, 65535))
            try:
                with silent():  # pydicom warns of values that it writes all the same
                    write(xray_dataset(frames_of(3, 20, 24), **changed), path)
            except (ValueError, TypeError, OverflowError):  # pydicom itself does not write it
                self.counts["refused"] += 1
                return
        try:
            run = read_xray(path)
            if not len(run) == len(run.images()) == len(run.primary_deg):
                raise WrongError("a run has other numbers of frames and pictures")
            cameras = [camera_of(run, frame) for frame in range(len(run))]
        except ValueError as error:
            if any(value in str(error) for value in PATIENT.values()):
                raise WrongError("a refusal quotes the patient") from error
            self.counts[refused(error)] += 1
            return
        if not all(np.isfinite(camera.P).all() for camera in cameras):
            raise WrongError("a camera is not finite")
        self.counts["accepted"] += 1
