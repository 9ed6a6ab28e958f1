"""Label volumes and CTs in NRRD files, segmentations of 3D Slicer among them.

Source: Teem's definition of the NRRD format (space, space directions, space origin); 3D Slicer's .seg.nrrd, whose
fields SegmentN_Name, SegmentN_LabelValue and SegmentN_Layer name the labels, or the codes in SegmentN_Tags.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import name_of_segment
from cathsim.anatomy.volume.files.detached import named_files
from cathsim.anatomy.volume.files.source import NO_VOXEL_SIZE, SIDES, UNIT_METRES, VolumeSource
from cathsim.anatomy.volume.files.values import BROKEN, in_words, read_values
from cathsim.guarded_reading import UnreadableFileError, referenced_file

SUFFIXES = (".nrrd", ".nhdr")
_SEGMENT = re.compile(r"^Segment(\d+)_(Name|LabelValue|Layer|ID|Tags)$")

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
        for key in ("sizes", "kinds", "space directions", "spacings"):
            if key in header and len(header[key]) != int(header["dimension"]):
                raise ValueError(f"{len(header[key])} {key} for {header['dimension']} axes")
        if not sizes or min(sizes) < 1:
            raise ValueError("sizes below 1")
        kind = _kind(header)
        data, packing, lines, skipped = _values_place(path, header)
    except UnreadableFileError:
        raise
    except (*BROKEN, nrrd.errors.NRRDError) as error:
        raise MeshRefusedError(f"{path.name} is no sound NRRD file ({in_words(error)}); export it again.") from None
    if str(header.get("Segmentation_MasterRepresentation", "")).startswith("Fractional"):
        raise MeshRefusedError(f"{path.name} holds fractions of segments; save it as binary label maps in 3D Slicer.")
    layer_axis, affine, notes = _axes(path, header, sizes)
    space, world = str(header.get("space", "")).strip().lower(), "LPS"
    words = space.removesuffix("-time").split("-")
    letters = ("".join(word[:1] for word in words) if len(words) == 3 else space).upper()
    if len(letters) == 3 and all(any(axis in side for axis in letters) for side in SIDES):
        world = letters
    elif space == "3d-left-handed":
        raise MeshRefusedError(f"{path.name} has axes in a mirrored space of no patient; save it again in 3D Slicer.")
    else:
        what = f"the file's space, {space}, is not the patient's" if space else "the file does not name its space"
        notes += (f"{what}: left, posterior, superior is assumed",)
    units = {str(unit).strip().lower() for unit in header.get("space units", [])}
    known = units & set(UNIT_METRES)
    if len(known) > 1:
        raise MeshRefusedError(f"{path.name} has axes in several units, {', '.join(sorted(known))}; save it in mm.")
    unit = known.pop() if known else "mm"
    if units - {unit, ""}:
        notes += (f"the unit {', '.join(sorted(units - {unit}))} of its axes is not known: {unit} is taken",)
    layers = 1 if layer_axis is None else sizes[layer_axis]
    across = [n for axis, n in enumerate(sizes) if axis != layer_axis]
    shape = (across[0], across[1], across[2])

    begins = start if data == path else 0

    def values() -> NDArray:
        held = read_values(path, kind, sizes, packing, data=data, start=begins, lines=lines, skip=skipped)
        return held[None] if layer_axis is None else np.moveaxis(held, layer_axis, 0)

    names = _segments(header, layered=layer_axis is not None)
    return VolumeSource(path, shape, affine, world, unit, kind.itemsize, values, layers, names, notes)


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
            "volume of the series as its own file."
        )
    affine = np.eye(4)
    if rows is None:
        spacings = np.abs(np.asarray(header.get("spacings", np.full(len(sizes), np.nan)), float)[spatial])
        known = np.isfinite(spacings) & (spacings > 0)
        affine[:3, :3] = np.diag(np.where(known, spacings, 1.0))
        notes += () if known.all() else (NO_VOXEL_SIZE,)
        notes += ("the file says nothing of the patient's axes: its voxels' order is taken for left, back, up",)
    else:
        affine[:3, :3] = np.stack([rows[axis] for axis in spatial], axis=1)
    origin = header.get("space origin")
    if origin is not None:
        affine[:3, 3] = np.asarray(origin, float)
    return (others[0] if others else None), affine, notes


def _segments(header: dict[str, Any], layered: bool) -> dict[tuple[int, int], str]:
    """Names of segments by layer and label; where files with layers say neither, each has its own and is 1 there."""
    fields: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if match := _SEGMENT.match(str(key)):
            fields.setdefault(int(match[1]), {})[match[2]] = str(value)
    named = {}
    for number, segment in fields.items():
        try:
            layer, value = (number, 1) if layered else (0, number + 1)
            place = (int(segment.get("Layer", layer)), int(segment.get("LabelValue", value)))
        except ValueError:
            continue
        named[place] = name_of_segment(segment.get("Name", segment.get("ID", "")), _meanings(segment.get("Tags", "")))
    return named


def _meanings(tags: str) -> list[str]:
    """What a segment's codes of type and region mean, each with its modifier, of a side.

    They are written TerminologyEntry:CONTEXT~CATEGORY~TYPE~MODIFIER~CONTEXT~REGION~MODIFIER, a code
    SCHEME^VALUE^MEANING, between vertical bars.
    """
    entry = next((tag for tag in tags.split("|") if tag.startswith("TerminologyEntry:")), "")
    kind, side, _, region, its_side = (code.split("^")[-1] for code in (entry + "~" * 6).split("~")[2:7])
    return [f"{side} {kind}", f"{its_side} {region}"]


def _values_place(path: Path, header: dict[str, Any]) -> tuple[Path, str, int, int]:
    """The file that holds the values, what packs them, lines and bytes that are skipped there; -1: all but the values.

    Raises:
        ValueError: the header asks for what is not read.
        UnreadableFileError: it names a file that is not beside it.
    """
    encodings = {
        **dict.fromkeys(("raw",), ""),
        **dict.fromkeys(("gz", "gzip"), "gzip"),
        **dict.fromkeys(("bz2", "bzip2"), "bzip2"),
        **dict.fromkeys(("txt", "text", "ascii"), "text"),
    }
    encoding = str(header.get("encoding", "raw")).strip().lower()
    if encoding not in encodings:
        raise ValueError(f"values of the encoding {encoding}")
    lines = int(header.get("line skip", header.get("lineskip", 0)))
    skipped = int(header.get("byte skip", header.get("byteskip", 0)))
    if lines < 0 or skipped < -1 or (skipped == -1 and encodings[encoding]):
        raise ValueError(f"{lines} lines and {skipped} bytes to skip")
    name = str(header.get("data file", header.get("datafile", "")))
    if not name:
        return path, encodings[encoding], lines, skipped
    if len(named_files(path)) != 1 or name.split()[0].upper() == "LIST":
        raise ValueError("its values lie in several files")
    return referenced_file(path, name), encodings[encoding], lines, skipped
