"""Label volumes and CTs in NRRD files, segmentations of 3D Slicer among them, read slab by slab.

Source: Teem's definition of the NRRD format (space, space directions, space origin); 3D Slicer's .seg.nrrd, whose
fields SegmentN_Name, SegmentN_LabelValue and SegmentN_Layer name the labels.
"""

from __future__ import annotations

import bz2
import gzip
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.nifti import BROKEN, SLAB_BYTES
from cathsim.anatomy.volume.files.source import UNIT_METRES, Slab, VolumeSource

SUFFIXES = (".nrrd", ".nhdr")
_SPACES = {
    "right-anterior-superior": "RAS",
    "ras": "RAS",
    "left-posterior-superior": "LPS",
    "lps": "LPS",
    "left-anterior-superior": "LAS",
    "las": "LAS",
}
_SEGMENT = re.compile(r"^Segment(\d+)_(Name|LabelValue|Layer|ID)$")

Array = NDArray[np.float64]


def open_nrrd(path: Path) -> VolumeSource:
    """Reads an NRRD file's header.

    Raises:
        MeshRefusedError: it is damaged or no volume, or pynrrd is missing.
    """
    try:
        import nrrd
    except ModuleNotFoundError:
        raise MeshRefusedError(f"{path.name} needs pynrrd: pip install 'endonav-cathsim[volumes]'.") from None
    try:
        with path.open("rb") as file:
            header = nrrd.read_header(file)
            start = file.tell()
        sizes = [int(n) for n in header["sizes"]]
        kind = _kind(header)
    except (*BROKEN, nrrd.errors.NRRDError) as error:
        raise MeshRefusedError(f"{path.name} is no sound NRRD file ({error}); export it again.") from None
    layer_axis, affine, notes = _axes(path, header, sizes)
    world = _SPACES.get(str(header.get("space", "")).lower(), "")
    if not world:
        world = "LPS"
        notes += ("the file does not name its space: left, posterior, superior is assumed",)
    units = [str(unit).strip().lower() for unit in header.get("space units", [])]
    unit = units[0] if units and units[0] in UNIT_METRES else "mm"
    layers = 1 if layer_axis is None else sizes[layer_axis]
    space = [n for axis, n in enumerate(sizes) if axis != layer_axis]
    shape = (space[0], space[1], space[2])

    def slabs() -> Iterator[Slab]:
        try:
            read = _stream(path, header, start, nrrd)
            across = int(np.prod(sizes[:-1]))
            step = max(1, int(SLAB_BYTES // (across * kind.itemsize)))
            for first in range(0, sizes[-1], step):
                count = min(step, sizes[-1] - first)
                values = np.frombuffer(read(count * across * kind.itemsize), dtype=kind)
                values = values.reshape((*sizes[:-1], count), order="F")
                yield first, values[None] if layer_axis is None else np.moveaxis(values, layer_axis, 0)
        except (*BROKEN, nrrd.errors.NRRDError) as error:
            raise MeshRefusedError(
                f"{path.name} is damaged: {error or type(error).__name__}; export it again."
            ) from None

    return VolumeSource(path, shape, affine, world, unit, kind.itemsize, slabs, layers, _segments(header), notes)


def _kind(header: dict[str, Any]) -> np.dtype[Any]:
    """The type of a file's values."""
    words = str(header["type"]).lower().replace("_t", "")
    plain = words.removeprefix("signed ")
    codes = {
        "i1": ("char", "int8"),
        "u1": ("uchar", "unsigned char", "uint8"),
        "i2": ("short", "short int", "int16"),
        "u2": ("ushort", "unsigned short", "unsigned short int", "uint16"),
        "i4": ("int", "int32"),
        "u4": ("uint", "unsigned int", "uint32"),
        "i8": ("longlong", "long long", "long long int", "int64"),
        "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64"),
        "f4": ("float",),
        "f8": ("double",),
    }
    code = next((code for code, known in codes.items() if plain in known), None)
    if code is None:
        raise ValueError(f"values of the type {words}")
    return np.dtype(code).newbyteorder(">" if str(header.get("endian", "little")).lower() == "big" else "<")


def _axes(path: Path, header: dict[str, Any], sizes: list[int]) -> tuple[int | None, Array, tuple[str, ...]]:
    """The axis of layers, the affine, and notes on what was assumed."""
    notes: tuple[str, ...] = ()
    kinds = [str(kind).lower() for kind in header.get("kinds", [])]
    directions = header.get("space directions")
    rows: list[Any] | None = None
    if directions is not None:
        rows = [None if row is None else np.asarray(row, float) for row in directions]
    spatial = list(range(len(sizes)))
    if rows is not None:
        spatial = [axis for axis, row in enumerate(rows) if row is not None and np.isfinite(row).all()]
    elif len(sizes) == 4 and "list" in kinds:
        spatial.remove(kinds.index("list"))
    others = [axis for axis in range(len(sizes)) if axis not in spatial]
    # the last axis is the slowest in the file: slabs are cut along it
    if len(spatial) != 3 or len(sizes) > 4 or (others and others[0] == len(sizes) - 1):
        raise MeshRefusedError(
            f"{path.name} has {len(sizes)} axes ({' x '.join(map(str, sizes))}), expected a volume of three or a "
            "segmentation of 3D Slicer; save one volume of the series as its own file."
        )
    if others and sizes[others[0]] > 1 and kinds and kinds[others[0]] in ("time", "vector", "3-vector", "rgb-color"):
        raise MeshRefusedError(
            f"{path.name} has {sizes[others[0]]} values a voxel ({kinds[others[0]]}), expected one label; save one "
            "volume "
            "of the series as its own file."
        )
    affine = np.eye(4)
    if rows is None:
        spacings = np.asarray(header.get("spacings", np.ones(len(sizes))), float)[spatial]
        affine[:3, :3] = np.diag(np.where(np.isfinite(spacings) & (spacings > 0), spacings, 1.0))
        notes += ("the file says nothing of the patient's axes: its voxels' order is taken for left, back, up",)
    else:
        affine[:3, :3] = np.stack([rows[axis] for axis in spatial], axis=1)
    origin = header.get("space origin")
    if origin is not None:
        affine[:3, 3] = np.asarray(origin, float)
    return (others[0] if others else None), affine, notes


def _segments(header: dict[str, Any]) -> dict[tuple[int, int], str]:
    """Names of segments by layer and label."""
    fields: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if match := _SEGMENT.match(str(key)):
            fields.setdefault(int(match[1]), {})[match[2]] = str(value)
    named = {}
    for number, segment in fields.items():
        try:
            place = (int(segment.get("Layer", 0)), int(segment.get("LabelValue", number + 1)))
        except ValueError:
            continue
        named[place] = segment.get("Name", segment.get("ID", ""))
    return named


def _stream(path: Path, header: dict[str, Any], start: int, nrrd: Any) -> Callable[[int], bytes]:
    """A function that reads so many more bytes of a file's values."""
    encoding = str(header.get("encoding", "raw")).lower()
    attached = "data file" not in header and "datafile" not in header
    skipped = any(int(header.get(key, 0)) for key in ("line skip", "lineskip", "byte skip", "byteskip"))
    if not attached or skipped or encoding not in ("raw", "gz", "gzip", "bz2", "bzip2"):
        content = np.asarray(nrrd.read(str(path), index_order="F")[0]).tobytes(order="F")
        place = [0]

        def held(count: int) -> bytes:
            place[0] += count
            return content[place[0] - count : place[0]]

        return held
    file: BinaryIO = path.open("rb")
    file.seek(start)
    if encoding == "raw":
        return file.read
    return (gzip.GzipFile(fileobj=file) if encoding.startswith("gz") else bz2.BZ2File(file)).read
