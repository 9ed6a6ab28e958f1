"""Label volumes and CTs in MetaImage files (.mha, .mhd with its data beside it), as ITK writes them.

Source: ITK's definition of the format; its world is left, posterior, superior, in mm.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.detached import HEADER_BYTES, header_fields, named_files
from cathsim.anatomy.volume.files.source import LARGEST, NO_VOXEL_SIZE, Slab, VolumeSource, require_one_volume
from cathsim.anatomy.volume.files.stream import SLAB_BYTES
from cathsim.guarded_reading import UnreadableFileError, check_regular, open_regular, referenced_file

SUFFIXES = (".mha", ".mhd")
_MOST_AXES = 10
_AXES = ("transformmatrix", "rotation", "orientation")  # keys of the header, one of which says how the voxels lie


def open_metaimage(path: Path) -> VolumeSource:
    """Reads a MetaImage file's header.

    Raises:
        MeshRefusedError: it is damaged or no volume, or SimpleITK is missing.
    """
    try:
        import SimpleITK
    except ModuleNotFoundError:
        raise MeshRefusedError(f"{path.name} needs SimpleITK: pip install 'endonav-cathsim[metaimage]'.") from None
    fields, data = _checked_header(path)  # before ITK, which believes whatever a header says
    reader = SimpleITK.ImageFileReader()
    reader.SetImageIO("MetaImageIO")
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        itemsize = SimpleITK.GetArrayViewFromImage(SimpleITK.Image([1, 1, 1], reader.GetPixelID())).itemsize
    except RuntimeError:
        raise MeshRefusedError(f"{path.name} is damaged: its header cannot be read; export it again.") from None
    axes = reader.GetDimension()
    sizes = require_one_volume(path, reader.GetSize(), reader.GetNumberOfComponents())
    if len(data) == 1:
        _check_values(path, fields, *data[0], math.prod(sizes) * itemsize)
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(reader.GetDirection(), (axes, axes))[:3, :3] * reader.GetSpacing()[:3]
    affine[:3, 3] = reader.GetOrigin()[:3]
    notes: tuple[str, ...] = () if fields.keys() & {"elementspacing", "elementsize"} else (NO_VOXEL_SIZE,)
    if not fields.keys() & set(_AXES):
        notes += ("the file says nothing of the patient's axes: its voxels' order is taken for left, back, up",)

    def slabs() -> Iterator[Slab]:
        try:
            image = reader.Execute()  # whole: ITK would unpack a packed file again for each slab
        except (RuntimeError, MemoryError):
            raise MeshRefusedError(
                f"{path.name} is damaged, or its data are not beside it; copy or export it again."
            ) from None
        values = SimpleITK.GetArrayViewFromImage(image).reshape(sizes[::-1]).transpose(2, 1, 0)
        step = max(1, int(SLAB_BYTES // (sizes[0] * sizes[1] * itemsize)))
        for first in range(0, sizes[2], step):
            # copied: what SimpleITK shows is gone with its image
            yield first, values[None, :, :, first : first + step].copy(order="F")

    return VolumeSource(path, sizes, affine, "LPS", "mm", itemsize, slabs, notes=notes)


def _checked_header(path: Path) -> tuple[dict[str, str], list[tuple[Path, int]]]:
    """The header's fields, and the files that hold the values with the first byte of each.

    Raises:
        MeshRefusedError: it is no header, or refers to what is no file beside it.
    """
    fields, _, end = header_fields(path)
    if not {"ndims", "dimsize", "elementdatafile"} <= fields.keys():
        raise MeshRefusedError(f"{path.name} is no MetaImage file; give a .mha file, or a .mhd file beside its data.")
    axes = fields["ndims"]
    sizes = fields["dimsize"].split()
    if not (
        axes.isdecimal()
        and 0 < int(axes) <= _MOST_AXES
        and len(sizes) == int(axes)
        and all(size.isdecimal() and 0 < int(size) < 1 << 31 for size in sizes)
    ):
        raise MeshRefusedError(
            f"{path.name} is damaged: its header cannot be read (NDims {axes[:20]}, DimSize {fields['dimsize'][:40]}); "
            "export it again."
        )
    if math.prod(map(int, sizes)) > LARGEST:
        raise MeshRefusedError(
            f"{path.name} holds {math.prod(map(int, sizes)) / 1e9:.1f} thousand million values, at most "
            f"{LARGEST / 1e9:g} are read; cut it to the chest."
        )
    names = named_files(path)
    if not names:
        return fields, [(path, end)]
    return fields, [(_beside(path, name), 0) for name in names]


def _beside(path: Path, name: str) -> Path:
    try:
        return referenced_file(path, name)
    except UnreadableFileError as error:
        if " refers to " in str(error) or "regular" in str(error):
            raise
        short_name = " ".join(name.split())[:80]
        raise MeshRefusedError(
            f"{path.name} is damaged, or its data are not beside it ({short_name}); copy or export it again."
        ) from None


def _check_values(path: Path, fields: dict[str, str], data: Path, start: int, size: int) -> None:
    """Refuses values that are cut off, followed by others, or damaged by what their checksum says.

    Args:
        start: first byte of them in `data`.
        size: bytes of them that the header promises.
    """
    fault = ""
    if fields.get("compresseddata", "").lower() in ("true", "1", "t"):
        fault = _fault_of_packed(data, start, size)
    elif fields.get("binarydata", "true").lower() in ("true", "1", "t") and fields.get("headersize", "0") == "0":
        held = check_regular(data) - start
        fault = "" if held == size else f"it holds {held} bytes of values, its header says {size}"
    if fault:
        raise MeshRefusedError(
            f"{path.name} is damaged, or its data are not beside it ({fault}); copy or export it again."
        )


def _fault_of_packed(data: Path, start: int, size: int) -> str:
    """Why what zlib has packed cannot be the values: ITK does not come to the checksum at its end."""
    unpacker = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib or gzip
    unpacked_size = 0
    with open_regular(data) as file:
        file.seek(start)
        try:
            while not unpacker.eof and (block := file.read(HEADER_BYTES)):
                while block and not unpacker.eof:
                    unpacked_size += len(unpacker.decompress(block, SLAB_BYTES))
                    block = unpacker.unconsumed_tail
                if unpacked_size > size:
                    return f"it holds more values than the {size} bytes that its header says"
        except zlib.error as error:
            return str(error)
        behind = unpacker.unused_data + file.read(HEADER_BYTES)
    if not unpacker.eof:
        return "it ends before its last value"
    if unpacked_size != size:
        return f"it holds {unpacked_size} bytes of values, its header says {size}"
    return "something follows its values" if any(behind) else ""
