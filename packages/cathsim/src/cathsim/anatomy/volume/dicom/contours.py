"""Labels from the contours of a DICOM structure set (RTSTRUCT), on the slices that they were drawn on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.dicom.files import CONVERTERS, Array, numbers, read_dicom
from cathsim.anatomy.volume.dicom.segmentation import Layers
from cathsim.anatomy.volume.dicom.slices import open_series, series_of
from cathsim.anatomy.volume.files.source import VolumeSource

_MARGIN = 2  # voxels around contours that no series frames
_LEAST_SIDE, _MOST_SIDE = 0.4, 1.5  # mm of a voxel in a slice where no series says it
_FLAT = 0.1  # mm by which the points of a contour may leave its slice
_BETWEEN = 0.3  # of the distance between slices by which a contour may lie beside one

Contours = dict[int, list[Array]]  # (n, 3) mm, by the number of their structure


def open_contours(path: Path) -> VolumeSource:
    """Reads a structure set.

    The lattice is that of the referenced series where its files lie in the same folder; else it follows the contours.

    Raises:
        MeshRefusedError: it holds no closed contours, or they lie in no slices.
    """
    header = read_dicom(path, pixels=True)
    names = {int(roi.ROINumber): str(roi.get("ROIName", "")) for roi in header.get("StructureSetROISequence", [])}
    contours: Contours = {}
    for roi in header.get("ROIContourSequence", []):
        for one in roi.get("ContourSequence", []) or []:
            data = one.get("ContourData") or []
            kind = str(one.get("ContourGeometricType", "")).upper()
            if kind.startswith("CLOSED") and len(data) >= 9 and len(data) % 3 == 0:
                points = numbers(path, data, len(data)).reshape(-1, 3)
                contours.setdefault(int(roi.get("ReferencedROINumber", 0)), []).append(points)
    if not contours:
        raise MeshRefusedError(f"{path.name} holds no closed contours; export the structures again, or {CONVERTERS}.")
    notes: tuple[str, ...] = ()
    if beside := series_beside(path, header):
        source = open_series(path.parent, beside)
        affine, shape = source.affine, source.shape
    else:
        affine, shape, side = _own_lattice(path, [one for some in contours.values() for one in some])
        notes += (f"the series of the contours is not beside them: voxels of {side:.2g} mm are taken",)
    layers = Layers(shape, path.name)
    placed = {}
    for number, some in contours.items():
        slices = _filled(path, some, affine, shape)
        if slices:
            placed[layers.add(number, slices), number] = names.get(number, "")
            gaps = max(slices) - min(slices) + 1 - len(slices)
            notes += (f"{names.get(number, number)} has no contour in {gaps} slices between others",) if gaps else ()
    if not placed:
        raise MeshRefusedError(
            f"{path.name} has no contour within the slices of its series; give the series it belongs to."
        )
    return VolumeSource(path, shape, affine, "LPS", "mm", 2, layers.values, len(layers.volumes), placed, notes)


def series_beside(path: Path, header: Any) -> list[tuple[Path, Any]]:
    """Files and headers of the series that a structure set refers to, where they lie in its folder."""
    for frame in header.get("ReferencedFrameOfReferenceSequence", []):
        for study in frame.get("RTReferencedStudySequence", []):
            for series in study.get("RTReferencedSeriesSequence", []):
                uid = str(series.get("SeriesInstanceUID", ""))
                if uid and (series_files := series_of(path.parent, uid)):
                    return series_files
    return []


def _own_lattice(path: Path, contours: list[Array]) -> tuple[Array, tuple[int, int, int], float]:
    """Affine (4, 4), voxels and side (mm) of a lattice of axial slices through all contours."""
    if max(float(np.ptp(one[:, 2])) for one in contours) > _FLAT:
        raise MeshRefusedError(
            f"{path.name} has contours across the body's axis; put its series' files into its folder."
        )
    heights = np.unique([round(float(one[:, 2].mean()), 2) for one in contours])
    step = float(np.median(np.diff(heights))) if len(heights) > 1 else 1.0
    lengths = [np.linalg.norm(np.diff(one[:, :2], axis=0), axis=1) for one in contours]
    side = float(np.clip(np.median(np.concatenate(lengths)), _LEAST_SIDE, _MOST_SIDE))
    every = np.concatenate(contours)
    low = every.min(axis=0) - [_MARGIN * side, _MARGIN * side, 0.0]
    counts = np.ceil((every.max(axis=0) - low) / [side, side, step]).astype(int) + np.array([_MARGIN, _MARGIN, 1])
    affine = np.diag([side, side, step, 1.0])
    affine[:3, 3] = low
    return affine, (int(counts[0]), int(counts[1]), int(counts[2])), side


def _filled(
    path: Path, contours: list[Array], affine: Array, shape: tuple[int, int, int]
) -> dict[int, NDArray[np.bool_]]:
    """Voxels (nx, ny) whose centres lie within contours or on them, by slice; one within another is a hole."""
    from skimage.measure import grid_points_in_poly

    to_index = np.linalg.inv(affine)
    by_slice: dict[int, list[Array]] = {}
    for points in contours:
        # rounded: contours that run through voxels' centres hold these
        at = np.round(points @ to_index[:3, :3].T + to_index[:3, 3], 4)
        k = int(np.rint(at[:, 2].mean()))
        if np.abs(at[:, 2] - k).max() > _BETWEEN:
            raise MeshRefusedError(f"{path.name} has contours that lie between slices of its series; {CONVERTERS}.")
        if 0 <= k < shape[2]:
            by_slice.setdefault(k, []).append(at[:, :2])
    filled = {}
    for k, some in by_slice.items():
        mask = np.zeros(shape[:2], dtype=bool)
        some.sort(key=lambda outline: -abs(_area(outline)))
        for outline in some:
            low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
            high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, shape[:2])
            if (high <= low).any():
                continue
            places = grid_points_in_poly(tuple(high - low), outline - low, binarize=False)
            part = mask[low[0] : high[0], low[1] : high[1]]
            within = places == 1
            if within.any() and part[within].mean() > 0.5:
                part[within] = False
            else:
                part[places > 0] = True
        if mask.any():
            filled[k] = mask
    return filled


def _area(outline: Array) -> float:
    x, y = outline.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
