"""X-ray files as pydicom writes them: plain and enhanced runs whose every attribute the caller chooses."""

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

XA = "1.2.840.10008.5.1.4.1.1.12.1"
ENHANCED_XA = "1.2.840.10008.5.1.4.1.1.12.1.1"
PATIENT = {"PatientName": "Doe^Jonathan", "PatientID": "MRN-774411", "PatientBirthDate": "19440607"}
GEOMETRY: dict[str, Any] = {
    "PositionerPrimaryAngle": "30",
    "PositionerSecondaryAngle": "-20",
    "DistanceSourceToDetector": "1100",
    "DistanceSourceToPatient": "750",
    "ImagerPixelSpacing": ["0.4", "0.2"],
}


def frames_of(count: int = 3, height: int = 24, width: int = 32, bits: int = 8) -> np.ndarray:
    """Noise (count, height, width) over the whole range of the stored bits."""
    values = np.random.default_rng(0).integers(0, 2**bits, (count, height, width))
    return values.astype(np.uint8 if bits <= 8 else np.uint16)


def item(**attributes: Any) -> Dataset:
    """A data set of some attributes."""
    made = Dataset()
    for keyword, value in attributes.items():
        setattr(made, keyword, value)
    return made


def xray_dataset(frames: np.ndarray, bits: int = 8, kind: str = XA, **changed: Any) -> Dataset:
    """An X-ray run in memory, with a patient; attributes given as None are left out."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = kind, generate_uid()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = item(SOPClassUID=kind, SOPInstanceUID=meta.MediaStorageSOPInstanceUID, Modality="XA", **PATIENT)
    dataset.file_meta = meta
    values: dict[str, Any] = {
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "NumberOfFrames": len(frames),
        "Rows": frames.shape[1],
        "Columns": frames.shape[2],
        "BitsAllocated": 8 * frames.itemsize,
        "BitsStored": bits,
        "HighBit": bits - 1,
        "PixelRepresentation": 0,
        **({} if kind == ENHANCED_XA else GEOMETRY),
        **changed,
    }
    for keyword, value in values.items():
        if value is not None:
            setattr(dataset, keyword, value)
    dataset.PixelData = frames.tobytes() + b"\0" * (frames.nbytes % 2)
    dataset["PixelData"].VR = "OB" if bits <= 8 else "OW"
    return dataset


def enhanced_groups(primary: list[float]) -> dict[str, Any]:
    """Functional groups of an enhanced run that turns: angles and times by frame, the rest shared."""
    shared = item(
        XRayGeometrySequence=Sequence([item(DistanceSourceToDetector=1100.0, DistanceSourceToIsocenter=750.0)]),
        FramePixelDataPropertiesSequence=Sequence([item(ImagerPixelSpacing=[0.3, 0.3])]),
        TablePositionSequence=Sequence(
            [item(TableTopVerticalPosition=5.0, TableTopLongitudinalPosition=1.0, TableTopLateralPosition=2.0)]
        ),
    )
    frames = [
        item(
            PositionerPositionSequence=Sequence([item(PositionerPrimaryAngle=angle, PositionerSecondaryAngle=0.0)]),
            FrameContentSequence=Sequence([item(FrameAcquisitionDateTime=f"20260102030405.{50_000 * k:06d}")]),
            FrameVOILUTSequence=Sequence([item(WindowCenter=str(100 + 20 * k), WindowWidth="100")]),
        )
        for k, angle in enumerate(primary)
    ]
    return {"SharedFunctionalGroupsSequence": Sequence([shared]), "PerFrameFunctionalGroupsSequence": Sequence(frames)}


def write(dataset: Dataset, path: Path) -> Path:
    """Writes a run; gives its path."""
    pydicom.dcmwrite(path, dataset, enforce_file_format=True)
    return path
