"""A CT as a series of slices, each in a DICOM file, in any order; values are Hounsfield units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.dicom.files import CONVERTERS, Array, axes_of, dicom_files, kind_of, numbers, read_dicom
from cathsim.anatomy.volume.files.source import VolumeSource
from cathsim.anatomy.volume.files.values import BROKEN, in_words

_LEAST_SLICES = 4
_UNEVEN = 0.1  # of the distance between slices by which it may vary
_MOST_TILT = 0.5  # degrees between the way from slice to slice and the slices' normal
_SHOWN = 4  # series in a message


def series_of(folder: Path, uid: str | None = None) -> list[tuple[Path, Any]]:
    """Files and headers of a folder's CT series, without localisers.

    Args:
        folder: with DICOM files of any kind.
        uid: of one series; None: there must be one alone.

    Raises:
        MeshRefusedError: there are several series, or none.
    """
    series: dict[str, list[tuple[Path, Any]]] = {}
    kinds = set()
    for path in dicom_files(folder):
        header = read_dicom(path)
        kinds.add(kind_of(header))
        if kind_of(header) == "CT" and "LOCALIZER" not in header.get("ImageType", []):
            series.setdefault(str(header.get("SeriesInstanceUID", "")), []).append((path, header))
    if uid is not None:
        return series.get(uid, [])
    if len(series) > 1:
        descriptions = [
            f"{some[0][1].get('SeriesNumber', '?')} {some[0][1].get('SeriesDescription', '')}".strip()
            + f" ({len(some)} files)"
            for some in series.values()
        ]
        raise MeshRefusedError(
            f"{folder.name} holds {len(series)} series of a CT: {', '.join(descriptions[:_SHOWN])}"
            f"{', …' if len(descriptions) > _SHOWN else ''}; put the one of the labels into a folder of its own."
        )
    if not series:
        raise MeshRefusedError(
            f"{folder.name} holds no CT series but DICOM files of the kind {', '.join(sorted(kinds)) or 'none'}; give "
            "the folder of the CT's slices."
        )
    return next(iter(series.values()))


def open_series(folder: Path, found: list[tuple[Path, Any]] | None = None) -> VolumeSource:
    """Reads the headers of a series of slices.

    Args:
        folder: with its files.
        found: files and headers of one series among them; None: the only one.

    Raises:
        MeshRefusedError: slices are missing or doubled, the gantry was tilted, or there is no one series.
    """
    found = found or series_of(folder)
    first_path, first = found[0]
    if "NumberOfFrames" in first and int(first.NumberOfFrames) > 1:
        raise MeshRefusedError(
            f"{first_path.name} holds all slices of a CT in one file, which is not read; {CONVERTERS}."
        )
    if len(found) < _LEAST_SLICES:
        raise MeshRefusedError(f"{folder.name} has {len(found)} slices of a CT; give the folder of the whole series.")
    axes = axes_of(first_path, first.get("ImageOrientationPatient"), first.get("PixelSpacing"))
    places = []
    for path, header in found:
        own = axes_of(path, header.get("ImageOrientationPatient"), header.get("PixelSpacing"))
        same = (header.get("Rows"), header.get("Columns")) == (first.get("Rows"), first.get("Columns"))
        if not same or np.abs(own - axes).max() > 1e-3:
            raise MeshRefusedError(
                f"{path.name} has another size or other axes than {first_path.name}; put the slices of one series into "
                "a folder of their own."
            )
        places.append(numbers(path, header.get("ImagePositionPatient"), 3))
    order = np.argsort(np.array(places) @ axes[:, 2], kind="stable")
    files = [found[k] for k in order]
    affine = _affine(folder, axes, np.array(places)[order])
    rows, columns = int(first.Rows), int(first.Columns)

    def values() -> NDArray:
        volume = np.empty((1, columns, rows, len(files)), np.float32, order="F")
        for at, (path, _) in enumerate(files):
            header = read_dicom(path, pixels=True)
            try:
                stored = np.asarray(header.pixel_array)
                if stored.shape != (rows, columns):
                    raise ValueError(f"{stored.shape} pixels instead of {(rows, columns)}")
            except (*BROKEN, AttributeError, NotImplementedError, RuntimeError) as error:
                raise MeshRefusedError(
                    f"{path.name} cannot be read: {in_words(error)}; export the series without compression, or "
                    f"{CONVERTERS.replace('it', 'the series', 1)}."
                ) from None
            slope, intercept = float(header.get("RescaleSlope", 1)), float(header.get("RescaleIntercept", 0))
            volume[0, :, :, at] = stored.T * np.float32(slope) + np.float32(intercept)
        return volume

    return VolumeSource(folder, (columns, rows, len(files)), affine, "LPS", "mm", 4, values)


def _affine(folder: Path, axes: Array, places: Array) -> Array:
    """(4, 4) from indices (column, row, slice) to mm.

    Args:
        folder: for messages.
        axes: as `axes_of` gives them.
        places: (n, 3) mm of the slices' first pixels, in order.
    """
    along = places @ axes[:, 2]
    steps = np.diff(along)
    step = float(np.median(steps))
    if steps.min() < _UNEVEN * step or step <= 0:
        raise MeshRefusedError(
            f"{folder.name} has two slices in one place ({along[int(np.argmin(steps))]:.1f} mm): the series holds "
            "several images of it, of phases or kernels; export one of them."
        )
    widest = int(np.argmax(np.abs(steps - step)))
    if abs(steps[widest] - step) > _UNEVEN * step:
        raise MeshRefusedError(
            f"{folder.name} lacks slices: from {along[widest]:.1f} to {along[widest + 1]:.1f} mm there is none, "
            f"elsewhere they lie {step:.3g} mm apart; copy or export the whole series again."
        )
    way = (places[-1] - places[0]) / (len(places) - 1)
    tilt = float(np.degrees(np.arccos(np.clip(way @ axes[:, 2] / np.linalg.norm(way), -1.0, 1.0))))
    if tilt > _MOST_TILT:
        raise MeshRefusedError(
            f"{folder.name} was taken with the gantry tilted by {tilt:.1f} degrees; resample it to right angles, as "
            "dcm2niix does."
        )
    affine = np.eye(4)
    affine[:3, :2], affine[:3, 2], affine[:3, 3] = axes[:, :2], way, places[0]
    return affine
