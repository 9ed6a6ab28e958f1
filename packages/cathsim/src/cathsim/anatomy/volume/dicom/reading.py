"""What a DICOM file or folder holds: the labels of a segmentation or structure set, or the slices of a CT."""

from __future__ import annotations

from pathlib import Path

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.dicom.contours import open_contours, series_beside
from cathsim.anatomy.volume.dicom.files import dicom_files, is_dicom_file, kind_of, read_dicom
from cathsim.anatomy.volume.dicom.segmentation import open_segmentation
from cathsim.anatomy.volume.dicom.slices import open_series
from cathsim.anatomy.volume.files.source import VolumeSource
from cathsim.anatomy.volume.files.values import BROKEN, in_words
from cathsim.guarded_reading import UnreadableFileError

_LABELS = {"SEG": open_segmentation, "RTSTRUCT": open_contours}
_SHOWN = 4  # files in a message


def open_dicom(path: Path, *, image: bool) -> VolumeSource:
    """Reads the headers of a DICOM file, or of a folder of them.

    Args:
        image: whether a CT is wanted, and no labels.

    Raises:
        MeshRefusedError: it holds none, or several, or is damaged.
    """
    try:
        return _opened(path, image)
    except (MeshRefusedError, UnreadableFileError):
        raise
    except (*BROKEN, AttributeError, NotImplementedError) as error:  # pydicom reads a value when it is asked for
        raise MeshRefusedError(f"{path.name} is a damaged DICOM file: {in_words(error)}; export it again.") from None


def _opened(path: Path, image: bool) -> VolumeSource:
    if image:
        if path.is_dir():
            return open_series(path)
        raise MeshRefusedError(f"{path.name} is one file of a DICOM series; give the folder that holds all its slices.")
    if not path.is_dir():
        kind = kind_of(read_dicom(path))
        if kind not in _LABELS:
            raise MeshRefusedError(
                f"{path.name} is a DICOM file of the kind {kind or 'none'}, expected a segmentation (SEG) or contours "
                "(RTSTRUCT): segment the vessels first, as TotalSegmentator and 3D Slicer do."
            )
        return _LABELS[kind](path)
    file_kinds = [(file, kind_of(read_dicom(file))) for file in dicom_files(path)]
    labels = [(file, kind) for file, kind in file_kinds if kind in _LABELS]
    if len(labels) != 1:
        names = ", ".join(file.name for file, _ in labels[:_SHOWN])
        kinds = ", ".join(sorted({kind or "none" for _, kind in file_kinds}))
        raise MeshRefusedError(
            f"{path.name} holds {len(labels)} segmentations and structure sets ({names}); give the path of one of them."
            if labels
            else f"{path.name} holds DICOM files of the kind {kinds}, but no labels: segment the vessels first, as "
            "TotalSegmentator and 3D Slicer do; the CT itself is given beside its labels."
        )
    file, kind = labels[0]
    return _LABELS[kind](file)


def beside(path: Path) -> list[Path]:
    """The slices in the folder of a structure set that its lattice comes from; none of another file."""
    if not is_dicom_file(path):
        return []
    try:
        header = read_dicom(path)
        return [file for file, _ in series_beside(path, header)] if kind_of(header) == "RTSTRUCT" else []
    except (*BROKEN, AttributeError):  # its reader says what is wrong
        return []
