"""A small patient in DICOM files: the slices of a CT, and the vessels that segmentations of it hold."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

SHAPE = (24, 20, 8)
SPACING = (0.8, 0.9, 2.0)  # mm: along a row, along a column, between slices
ORIGIN = (40.0, -30.0, 12.0)
VESSELS = {1: "aorta", 2: "Left subclavian artery"}


def masks() -> dict[int, np.ndarray]:
    """Voxels (nx, ny, nz) of both vessels, which overlap."""
    aorta, branch = np.zeros(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=bool)
    aorta[4:12, 5:13] = True
    branch[10:20, 7:10, 3:6] = True
    return {1: aorta, 2: branch}


def affine(turn: np.ndarray) -> np.ndarray:
    """(4, 4) from indices to mm."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn * SPACING, ORIGIN
    return found


def write_series(
    folder: Path,
    values: np.ndarray,
    turn: np.ndarray | None = None,
    *,
    series: str = "1.2.3.4",
    spacing: Sequence[float] = SPACING,
    origin: Sequence[float] = ORIGIN,
    **more: Any,
) -> list[Path]:
    """Writes slices of Hounsfield units (nx, ny, nz) by pydicom, in files whose names are in no order.

    Columns of `turn` are the axes, the patient's where it is left out; `more` are further attributes of each slice.
    """
    from pydicom.dataset import FileDataset, FileMetaDataset
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

    turn = np.eye(3) if turn is None else turn
    folder.mkdir(exist_ok=True)
    paths = []
    for k in range(values.shape[2]):
        meta = FileMetaDataset()
        meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = CTImageStorage, f"{series}.{k + 1}"
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        path = folder / f"{(5 * k + 3) % 97:02d}_{k}_{series}.dcm"
        one = FileDataset(str(path), {}, file_meta=meta, preamble=bytes(128))
        one.SOPClassUID, one.SOPInstanceUID = CTImageStorage, f"{series}.{k + 1}"
        one.Modality, one.PatientName, one.PatientID = "CT", "Nobody", "0"
        one.PatientBirthDate, one.PatientSex, one.AccessionNumber, one.ReferringPhysicianName = "", "", "", ""
        one.StudyInstanceUID, one.SeriesInstanceUID, one.FrameOfReferenceUID = "1.2.3.5", series, "1.2.3.6"
        one.StudyID, one.StudyDate, one.StudyTime = "1", "20200101", "000000"
        one.SeriesNumber, one.InstanceNumber = 3, k + 1
        one.SeriesDescription, one.Manufacturer, one.ManufacturerModelName = "THORAX", "None", "None"
        one.DeviceSerialNumber, one.SoftwareVersions, one.PositionReferenceIndicator = "0", "0", ""
        one.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        one.Rows, one.Columns = values.shape[1], values.shape[0]
        one.PixelSpacing, one.SliceThickness = [float(spacing[1]), float(spacing[0])], float(spacing[2])
        one.ImageOrientationPatient = _decimals([*turn[:, 0], *turn[:, 1]])
        one.ImagePositionPatient = _decimals(np.array(origin) + k * spacing[2] * turn[:, 2])
        one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
        one.BitsAllocated, one.BitsStored, one.HighBit, one.PixelRepresentation = 16, 16, 15, 0
        one.RescaleSlope, one.RescaleIntercept = 0.5, -1024
        one.PixelData = ((values[:, :, k].T + 1024) / 0.5).astype("<u2").tobytes()
        for key, value in more.items():
            setattr(one, key, value)
        one.save_as(path)
        paths.append(path)
    return paths


def write_segmentation(path: Path, labels: np.ndarray, affine: np.ndarray, names: Mapping[int, str]) -> None:
    """Writes a binary segmentation by pydicom, as small as a reader allows; the affine leads to the patient's mm."""
    from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
    from pydicom.pixels.utils import pack_bits
    from pydicom.uid import ExplicitVRLittleEndian, SegmentationStorage

    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = SegmentationStorage, "1.2.3.8.1"
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    one = FileDataset(str(path), {}, file_meta=meta, preamble=bytes(128))
    one.SOPClassUID, one.SOPInstanceUID, one.Modality = SegmentationStorage, "1.2.3.8.1", "SEG"
    one.SeriesInstanceUID, one.StudyInstanceUID, one.SegmentationType = "1.2.3.8", "1.2.3.5", "BINARY"
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    turn = affine[:3, :3] / spacing
    measures, orientation, shared = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = [float(spacing[1]), float(spacing[0])]
    measures.SpacingBetweenSlices = measures.SliceThickness = float(spacing[2])
    orientation.ImageOrientationPatient = _decimals([*turn[:, 0], *turn[:, 1]])
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    one.SharedFunctionalGroupsSequence = [shared]
    one.SegmentSequence, one.PerFrameFunctionalGroupsSequence, masks = [], [], []
    for number, name in names.items():
        segment = Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        one.SegmentSequence.append(segment)
        for k in np.flatnonzero((labels == number).any(axis=(0, 1))):
            place, which, frame = Dataset(), Dataset(), Dataset()
            place.ImagePositionPatient = _decimals(affine[:3, 3] + k * affine[:3, 2])
            which.ReferencedSegmentNumber = number
            frame.PlanePositionSequence, frame.SegmentIdentificationSequence = [place], [which]
            one.PerFrameFunctionalGroupsSequence.append(frame)
            masks.append((labels[:, :, k] == number).T)
    one.NumberOfFrames, one.Rows, one.Columns = len(masks), labels.shape[1], labels.shape[0]
    one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
    one.BitsAllocated = one.BitsStored = 1
    one.HighBit = one.PixelRepresentation = 0
    one.PixelData = pack_bits(np.concatenate(masks).astype(np.uint8).ravel())
    one.save_as(path)


def _decimals(numbers: Any) -> list[float]:
    """Numbers of at most 16 characters, as DICOM holds them."""
    return [round(float(number), 9) for number in numbers]
