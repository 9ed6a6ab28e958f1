"""Labels in a DICOM segmentation object: binary, fractional or a map of labels; names from its segments.

Source: DICOM PS3.3, A.51 and C.8.20: functional groups give every frame its place and segment.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import name_of_segment
from cathsim.anatomy.volume.dicom.files import CONVERTERS, Array, attribute, axes_of, numbers, read_dicom
from cathsim.anatomy.volume.files.source import LARGEST, VolumeSource
from cathsim.anatomy.volume.files.values import BROKEN, in_words

_OFF_GRID = 0.1  # of the distance between slices by which a frame may lie beside its place
_FEW_GAPS, _UNEVEN = 3, 0.1  # gaps between slices, and their share, from which on the slices are uneven
_MOST_SLICES = 10_000


def open_segmentation(path: Path) -> VolumeSource:
    """Reads a segmentation object.

    Raises:
        MeshRefusedError: it is damaged, lies on no lattice, or is of a kind that is not read.
    """
    header = read_dicom(path, pixels=True)
    kind = str(header.get("SegmentationType", "")).upper()
    if kind not in ("BINARY", "FRACTIONAL", "LABELMAP"):
        raise MeshRefusedError(f"{path.name} is a segmentation of the unknown kind {kind!r}; {CONVERTERS}.")
    groups = list(header.get("PerFrameFunctionalGroupsSequence", []))
    shared = (list(header.get("SharedFunctionalGroupsSequence", [])) or [{}])[0]
    frames, rows, columns = (int(header.get(key, 0)) for key in ("NumberOfFrames", "Rows", "Columns"))
    if not frames or frames != len(groups) or float(frames) * rows * columns > LARGEST:
        raise MeshRefusedError(
            f"{path.name} is damaged, or too large: {frames} frames, {len(groups)} places; {CONVERTERS}."
        )

    def of_frame(group: Any, sequence: str, *names: str) -> Any:
        return attribute(path, group if sequence in group else shared, sequence, *names)

    axes = axes_of(
        path,
        of_frame(groups[0], "PlaneOrientationSequence", "ImageOrientationPatient"),
        of_frame(groups[0], "PixelMeasuresSequence", "PixelSpacing"),
    )
    places = np.array([numbers(path, of_frame(g, "PlanePositionSequence", "ImagePositionPatient"), 3) for g in groups])
    measures = (groups[0] if "PixelMeasuresSequence" in groups[0] else shared).get("PixelMeasuresSequence", [{}])[0]
    header_step = float(measures.get("SpacingBetweenSlices", 0) or measures.get("SliceThickness", 0) or 0)
    affine, at = _lattice(path, axes, places, header_step)
    layers = Layers((columns, rows, int(at.max()) + 1), path.name)
    names: dict[tuple[int, int], str] = {}
    segments = {int(one.SegmentNumber): _name(one) for one in header.get("SegmentSequence", [])}
    by_segment: dict[int, list[int]] = {}
    for frame, group in enumerate(groups):
        number = 0 if kind == "LABELMAP" else int(
            of_frame(group, "SegmentIdentificationSequence", "ReferencedSegmentNumber")
        )  # fmt: skip
        by_segment.setdefault(number, []).append(frame)
    limit = 0.5 * float(header.get("MaximumFractionalValue", 1)) if kind == "FRACTIONAL" else 0.5
    notes: tuple[str, ...] = ("the segmentation is fractional: half and more is taken",) if kind == "FRACTIONAL" else ()
    for number, some in by_segment.items():
        images = _frames(path, header, some)
        if kind == "LABELMAP":
            maps = {int(at[frame]): image for frame, image in images}
            for value in np.unique(np.concatenate([np.unique(image) for image in maps.values()])):
                if value:
                    names[layers.add(int(value), {k: image == value for k, image in maps.items()}), int(value)] = (
                        segments.get(int(value), "")
                    )
            continue
        masks: dict[int, NDArray[np.bool_]] = {}
        for frame, image in images:
            masks[int(at[frame])] = masks.get(int(at[frame]), False) | (image >= limit)
        names[layers.add(number, masks), number] = segments.get(number, "")
        if gaps := max(masks) - min(masks) + 1 - len(masks):
            notes += (f"{segments.get(number) or number} has no frame in {gaps} slices between others",)
    return VolumeSource(path, layers.shape, affine, "LPS", "mm", 2, layers.values, len(layers.volumes), names, notes)


def _lattice(path: Path, axes: Array, places: Array, header_step: float) -> tuple[Array, NDArray[np.int64]]:
    """The affine (4, 4), and the slice of every frame; slices without any segment have no frame."""
    along = places @ axes[:, 2]
    first, away = places[int(np.argmin(along))], along - along.min()
    apart = np.diff(np.unique(np.round(along, 3)))
    step = header_step
    if len(apart):  # the places tell, but for segments that leave out whole slices
        step = float(apart[apart < 1.5 * apart.min()].mean())
        step = float(away.max() / np.rint(away.max() / step))
        if header_step > 0 and _beside(away, step) > _OFF_GRID > _beside(away, header_step):
            step = header_step
    if not step > 0 or away.max() / step > _MOST_SLICES:
        raise MeshRefusedError(f"{path.name} does not say how far its slices lie apart; {CONVERTERS}.")
    at = np.rint(away / step)
    gaps = np.diff(np.unique(at))
    if np.count_nonzero(gaps > 1) >= max(_FEW_GAPS, _UNEVEN * len(gaps)) or _beside(away, step) > _OFF_GRID:
        raise MeshRefusedError(
            f"{path.name} has slices that lie {apart.min():.3g} to {apart.max():.3g} mm apart; resample it to even "
            "ones, or export all of them."
        )
    off = places - first - at[:, None] * step * axes[:, 2]
    if np.abs(off).max() > _OFF_GRID * max(step, float(np.linalg.norm(axes[:, 0]))):
        raise MeshRefusedError(f"{path.name} has frames that lie on no one lattice of voxels; {CONVERTERS}.")
    affine = np.eye(4)
    affine[:3, :2], affine[:3, 2], affine[:3, 3] = axes[:, :2], step * axes[:, 2], first
    return affine, at.astype(np.int64)


def _beside(away: Array, step: float) -> float:
    """The greatest part of a step by which distances lie beside a whole number of steps."""
    return float(np.abs(away / step - np.rint(away / step)).max())


def _frames(path: Path, header: Any, some: list[int]) -> Iterator[tuple[int, NDArray]]:
    """Frames by number, each (columns, rows)."""
    from pydicom.pixels import iter_pixels

    bits, kind = int(header.Rows) * int(header.Columns), header.file_meta.TransferSyntaxUID
    if header.BitsAllocated == 1 and kind.is_little_endian and not kind.is_compressed:
        octets = np.frombuffer(header.PixelData, np.uint8)  # a frame may begin within a byte
        if 8 * len(octets) < bits * int(header.NumberOfFrames):
            raise MeshRefusedError(f"{path.name} is cut off: its frames are not all there; export it again.")
        for frame in some:
            start = frame * bits
            part = np.unpackbits(octets[start // 8 : (start + bits + 7) // 8], bitorder="little")
            yield frame, part[start % 8 : start % 8 + bits].reshape(header.Rows, header.Columns).T
        return
    try:
        for frame, image in zip(some, iter_pixels(header, indices=some, raw=True), strict=True):
            yield frame, np.asarray(image).T
    except (*BROKEN, AttributeError, NotImplementedError, RuntimeError) as error:
        raise MeshRefusedError(f"{path.name} cannot be read: {in_words(error)}; {CONVERTERS}.") from None


def _name(segment: Any) -> str:
    """What a segment is called: its label, or its coded structure with its side where the label says nothing."""
    meanings = []
    for sequence in ("SegmentedPropertyTypeCodeSequence", "AnatomicRegionSequence"):
        for coded in segment.get(sequence, []):
            sides = [
                str(side.get("CodeMeaning", ""))
                for key in ("SegmentedPropertyTypeModifierCodeSequence", "AnatomicRegionModifierSequence")
                for side in [*coded.get(key, []), *segment.get(key, [])]
            ]
            meanings.append(" ".join([*dict.fromkeys(sides), str(coded.get("CodeMeaning", ""))]))
    return name_of_segment(str(segment.get("SegmentLabel", "")).strip(), meanings)


class Layers:
    """Volumes of labels, filled segment by segment.

    Args:
        shape: voxels along the axes.
    """

    def __init__(self, shape: tuple[int, int, int], file: str) -> None:
        self.shape, self.file = shape, file
        self.volumes: list[NDArray[np.uint16]] = []

    def add(self, number: int, slices: dict[int, NDArray[np.bool_]]) -> int:
        """Puts a segment of masks (nx, ny) by slice where it overlaps no other; returns its layer."""
        free = [
            layer
            for layer, volume in enumerate(self.volumes)
            if not any((volume[:, :, at] != 0)[mask].any() for at, mask in slices.items())
        ]
        layer = free[0] if free else len(self.volumes)
        if not free:
            if (layer + 1) * 2 * float(np.prod(self.shape)) > LARGEST:
                raise MeshRefusedError(
                    f"{self.file} has segments that overlap over too many voxels; export the vessels alone."
                )
            self.volumes.append(np.zeros(self.shape, dtype=np.uint16, order="F"))
        for at, mask in slices.items():
            self.volumes[layer][:, :, at][mask] = number
        return layer

    def values(self) -> NDArray[np.uint16]:
        """All layers, (layers, nx, ny, nz)."""
        return np.stack(self.volumes)
