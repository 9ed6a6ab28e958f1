"""Label volumes and CTs in MetaImage files (.mha, .mhd with its data beside it), as ITK writes them.

Source: ITK's definition of the format; its world is left, posterior, superior, in mm.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.detached import header_fields, named_files
from cathsim.anatomy.volume.files.source import LARGEST, NO_VOXEL_SIZE, VolumeSource, require_one_volume
from cathsim.anatomy.volume.files.values import read_values
from cathsim.guarded_reading import UnreadableFileError, referenced_file

SUFFIXES = (".mha", ".mhd")
_MOST_AXES = 10
_FLAGS = {"compresseddata": ("true", "1", "t"), "binarydata": ("false", "0", "f")}
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
        kind = SimpleITK.GetArrayViewFromImage(SimpleITK.Image([1, 1, 1], reader.GetPixelID())).dtype
    except RuntimeError:
        raise MeshRefusedError(f"{path.name} is damaged: its header cannot be read; export it again.") from None
    axes = reader.GetDimension()
    sizes = require_one_volume(path, reader.GetSize(), reader.GetNumberOfComponents())
    packed, text = (fields.get(key, "").lower() in words for key, words in _FLAGS.items())
    if len(data) == 1 and (packed or (not text and fields.get("headersize", "0") == "0")):  # ITK compares no checksum
        read_values(path, kind, sizes, "zlib" if packed else "", data=data[0][0], start=data[0][1])
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(reader.GetDirection(), (axes, axes))[:3, :3] * reader.GetSpacing()[:3]
    affine[:3, 3] = reader.GetOrigin()[:3]
    notes: tuple[str, ...] = () if fields.keys() & {"elementspacing", "elementsize"} else (NO_VOXEL_SIZE,)
    if not fields.keys() & set(_AXES):
        notes += ("the file says nothing of the patient's axes: its voxels' order is taken for left, back, up",)

    def values() -> NDArray:
        try:
            image = reader.Execute()
        except (RuntimeError, MemoryError):
            raise MeshRefusedError(
                f"{path.name} is damaged, or its data are not beside it; copy or export it again."
            ) from None
        return SimpleITK.GetArrayFromImage(image).reshape(sizes[::-1]).transpose(2, 1, 0)[None]

    return VolumeSource(path, sizes, affine, "LPS", "mm", kind.itemsize, values, notes=notes)


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
