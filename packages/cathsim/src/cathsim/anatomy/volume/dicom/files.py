"""DICOM files: which of a folder's are some, their headers, and what is said of those that are not read."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.values import BROKEN, in_words
from cathsim.guarded_reading import UnreadableFileError, check_regular, open_regular

CONVERTERS = "convert it to .nii.gz, as dcm2niix and 3D Slicer do"
_PREAMBLE = 128
_SUFFIXES = ("", ".dcm", ".dicom", ".ima")
_LOOKED_AT = 20  # files of a folder by which it is known as one of DICOM files

Array = NDArray[np.float64]


def is_dicom_file(path: Path) -> bool:
    """Whether a regular file begins as DICOM files do."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            return False
        with open_regular(path) as file:
            return file.read(_PREAMBLE + 4)[_PREAMBLE:] == b"DICM"
    except (OSError, ValueError):
        return False


def is_dicom_folder(folder: Path) -> bool:
    """Whether a folder holds DICOM files."""
    return os.path.isdir(folder) and any(is_dicom_file(path) for path in _candidates(folder)[:_LOOKED_AT])


def dicom_files(folder: Path) -> list[Path]:
    """The DICOM files of a folder, by name, without its directory of them."""
    return [path for path in _candidates(folder) if is_dicom_file(path)]


def _candidates(folder: Path) -> list[Path]:
    paths = (path for path in folder.iterdir() if not path.name.startswith(".") and path.name.upper() != "DICOMDIR")
    # of slices named 1.2.840.113… the last number is no ending
    return sorted(path for path in paths if path.suffix.lower() in _SUFFIXES or path.suffix[1:].isdecimal())


def read_dicom(path: Path, pixels: bool = False) -> Any:
    """A DICOM file's header, with its pixels where they are wanted.

    Raises:
        MeshRefusedError: it is damaged, or pydicom is missing.
    """
    try:
        import pydicom
    except ModuleNotFoundError:
        raise MeshRefusedError(f"{path.name} needs pydicom: pip install 'endonav-cathsim[dicom]'.") from None
    try:
        check_regular(path)
        return pydicom.dcmread(path, stop_before_pixels=not pixels)
    except UnreadableFileError:
        raise
    except (*BROKEN, AttributeError, pydicom.errors.InvalidDicomError) as error:
        raise MeshRefusedError(f"{path.name} is a damaged DICOM file: {in_words(error)}; export it again.") from None


def kind_of(header: Any) -> str:
    """The modality of a DICOM file: "CT", "SEG", "RTSTRUCT" and others."""
    return str(header.get("Modality", "")).strip().upper()


def attribute(path: Path, group: Any, *names: str) -> Any:
    """A value within nested sequences, of the first item each.

    Raises:
        MeshRefusedError: it is missing.
    """
    for name in names:
        value = group.get(name)
        if value is None or (name.endswith("Sequence") and not len(value)):
            raise MeshRefusedError(f"{path.name} has no {name}, which its place in the patient needs; {CONVERTERS}.")
        group = value[0] if name.endswith("Sequence") else value
    return group


def numbers(path: Path, value: Any, count: int) -> Array:
    """So many finite numbers.

    Raises:
        MeshRefusedError: they are others.
    """
    try:
        array = np.array([float(one) for one in value], dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if len(array) != count or not np.isfinite(array).all():
        raise MeshRefusedError(f"{path.name} is damaged: {value!s:.60} are not {count} numbers; export it again.")
    return array


def axes_of(path: Path, orientation: Any, spacing: Any) -> Array:
    """(3, 3) columns: along a slice's rows, along its columns (both mm per pixel), and across it (a unit vector).

    Args:
        path: for messages.
        orientation: ImageOrientationPatient.
        spacing: PixelSpacing, between rows first.
    """
    cosines, between = numbers(path, orientation, 6), numbers(path, spacing, 2)
    across = np.cross(cosines[:3], cosines[3:])
    length = float(np.linalg.norm(across))
    if not 0.9 < length < 1.1:
        raise MeshRefusedError(f"{path.name} is damaged: the axes of its slices are none; export it again.")
    return np.stack([cosines[:3] * between[1], cosines[3:] * between[0], across / length], axis=1)
