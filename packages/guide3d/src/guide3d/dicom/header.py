"""The attributes of an X-ray file that images and cameras are made of, and no others: a patient's are never read.

pydicom's own warnings quote values of the file, so they are kept from the log, and its errors become sentences of ours.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from guide3d.geometry.polyline import Array
from guide3d.guarded_reading import open_regular

_KINDS = {
    "1.2.840.10008.5.1.4.1.1.12.1": "XA",
    "1.2.840.10008.5.1.4.1.1.12.1.1": "enhanced XA",
    "1.2.840.10008.5.1.4.1.1.12.2": "RF",
    "1.2.840.10008.5.1.4.1.1.12.2.1": "enhanced RF",
}
_SHARED, _PER_FRAME = "SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"
PIXEL_ATTRIBUTES = (
    "SamplesPerPixel", "PhotometricInterpretation", "NumberOfFrames", "Rows", "Columns", "BitsAllocated", "BitsStored",
    "HighBit", "PixelRepresentation", "PlanarConfiguration", "ExtendedOffsetTable", "ExtendedOffsetTableLengths",
    "PixelData",
)  # fmt: skip
GREY_ATTRIBUTES = ("WindowCenter", "WindowWidth", "VOILUTFunction", "VOILUTSequence", "PresentationLUTShape")
TIME_ATTRIBUTES = ("FrameTime", "FrameTimeVector", "CineRate", "RecommendedDisplayFrameRate")
GEOMETRY_ATTRIBUTES = (
    "PositionerPrimaryAngle", "PositionerSecondaryAngle", "PositionerPrimaryAngleIncrement",
    "PositionerSecondaryAngleIncrement", "DetectorPrimaryAngle", "DetectorSecondaryAngle", "DistanceSourceToDetector",
    "DistanceSourceToPatient", "EstimatedRadiographicMagnificationFactor", "ImagerPixelSpacing", "FieldOfViewShape",
    "FieldOfViewDimensions", "TableHeight", "TableVerticalIncrement", "TableLongitudinalIncrement",
    "TableLateralIncrement", "PatientOrientation",
)  # fmt: skip
ORDER_ATTRIBUTES = (
    "SeriesInstanceUID", "SeriesNumber", "InstanceNumber", "AcquisitionDateTime", "AcquisitionDate", "AcquisitionTime",
    "ContentDate", "ContentTime",
)  # fmt: skip
_WANTED = ("SOPClassUID", "Modality", "RescaleSlope", "PixelValueTransformationSequence", "BurnedInAnnotation",
           "MaskSubtractionSequence", "RecommendedViewingMode", _SHARED, _PER_FRAME, *PIXEL_ATTRIBUTES,
           *GREY_ATTRIBUTES, *TIME_ATTRIBUTES, *GEOMETRY_ATTRIBUTES, *ORDER_ATTRIBUTES)  # fmt: skip
_LARGEST = 4 << 30  # bytes of a file
_FIRST_GROUPS = (b"\x02\0", b"\x08\0")  # of a file without a preamble


class OtherKindError(ValueError):
    """A file is no DICOM, or no X-ray."""


class Header:
    """The wanted attributes of one file, by their DICOM keywords, where need be frame by frame.

    A frame's own functional groups go before the groups that all frames share, and those before the file's own.
    """

    def __init__(self, path: str | Path) -> None:
        """Reads a file.

        Raises:
            FileNotFoundError: there is no such file.
            ImportError: pydicom is not installed.
            ValueError: the file is no DICOM, damaged, or of another kind than XA or RF (`OtherKindError`).
        """
        self.path = Path(path)
        dcmread = pydicom_reader()
        if not self.path.exists():
            raise FileNotFoundError(f"DICOM file {self.path} is missing")
        with open_regular(self.path, _LARGEST) as file:
            start = file.read(132)
        marked = start[128:] == b"DICM"
        if not marked and start[:2] not in _FIRST_GROUPS:
            raise OtherKindError(f"{self.path}: expected a DICOM file, found something else")
        with silent():
            try:
                self.dataset: Any = dcmread(self.path, specific_tags=list(_WANTED), force=not marked)
                meta = self.dataset.file_meta
                if "TransferSyntaxUID" not in meta:  # a file without a preamble need not have it
                    implicit, _ = self.dataset.original_encoding
                    meta.TransferSyntaxUID = f"1.2.840.10008.1.2{'' if implicit else '.1'}"
                kind = str(self.dataset.get("SOPClassUID") or meta.get("MediaStorageSOPClassUID", ""))
            except (OSError, MemoryError):
                raise
            except Exception:  # a damaged file raises a dozen kinds, and quotes what it holds
                raise self.damaged() from None
        if kind not in _KINDS:
            raise OtherKindError(f"{self.path}: expected an X-ray run (XA or RF), found {_name_of(kind)}")
        self.kind = _KINDS[kind]

    def damaged(self) -> ValueError:
        """What to raise for a file that cannot be understood."""
        return ValueError(f"{self.path}: expected a whole DICOM file, found a damaged or truncated one")

    def find(self, keyword: str, frame: int = 0) -> Any:
        """The value of an attribute at a frame, counted from 0; None where it is missing or empty."""
        with silent():
            try:
                for item in self._places(frame):
                    value = item.get(keyword)
                    if value is not None and not (hasattr(value, "__len__") and len(value) == 0):
                        return value
            except Exception:  # a value that its kind does not allow
                raise ValueError(f"{self.path}: {keyword} cannot be understood") from None
        return None

    def numbers(self, keyword: str, frame: int = 0) -> Array:
        """The numbers (k,) of an attribute; none where it is missing.

        Raises:
            ValueError: it holds something else than finite numbers.
        """
        value = self.find(keyword, frame)
        if value is None:
            return np.zeros(0)
        try:
            numbers = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            numbers = np.full(1, np.nan)
        if numbers.ndim != 1 or not np.isfinite(numbers).all():
            raise ValueError(f"{self.path}: {keyword} should be finite numbers, found something else")
        return numbers

    def number(self, keyword: str, frame: int = 0) -> float:
        """The first number of an attribute; NaN where it is missing."""
        numbers = self.numbers(keyword, frame)
        return float(numbers[0]) if len(numbers) else float("nan")

    def word(self, keyword: str) -> str:
        """A code in capitals, e.g. "MONOCHROME2"; empty where it is missing."""
        value = self.find(keyword)
        return "" if value is None else str(value).strip().upper()

    def _places(self, frame: int) -> Iterator[Any]:
        for group, index in ((_PER_FRAME, frame), (_SHARED, 0)):
            items = self.dataset.get(group) or []
            if index < len(items):
                yield items[index]
                for element in items[index]:
                    if element.VR == "SQ" and len(element.value):
                        yield element.value[0]
        yield self.dataset


@contextmanager
def silent() -> Iterator[None]:
    """Keeps pydicom's messages from log and screen: they quote values of the file."""
    logger = logging.getLogger("pydicom")
    logger_state = logger.handlers, logger.propagate
    logger.handlers, logger.propagate = [logging.NullHandler()], False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.handlers, logger.propagate = logger_state


def pydicom_reader() -> Any:
    """Pydicom's function that reads a file; ImportError, which says what to install, without it."""
    try:
        import pydicom.pixels  # the decoders
    except ImportError:
        raise ImportError("DICOM files are read with pydicom: pip install 'endonav-guide3d[dicom]'") from None
    return pydicom.dcmread


def _name_of(kind: str) -> str:
    from pydicom.uid import UID_dictionary

    return UID_dictionary[kind][0] if kind in UID_dictionary else "a file of another kind"
