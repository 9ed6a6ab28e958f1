"""Label volumes and CTs in MetaImage files (.mha, .mhd with its data beside it), as ITK writes them.

Source: ITK's definition of the format; its world is left, posterior, superior, in mm.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.nifti import SLAB_BYTES
from cathsim.anatomy.volume.files.source import Slab, VolumeSource, require_one_volume

SUFFIXES = (".mha", ".mhd")
_HEADER_BYTES = 1 << 16
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
    keys = _keys(path)  # before ITK, which prints lines of its own about files of another kind
    if not {"ndims", "dimsize", "elementdatafile"} <= keys:
        raise MeshRefusedError(f"{path.name} is no MetaImage file; give a .mha file, or a .mhd file beside its data.")
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
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(reader.GetDirection(), (axes, axes))[:3, :3] * reader.GetSpacing()[:3]
    affine[:3, 3] = reader.GetOrigin()[:3]
    notes: tuple[str, ...] = ()
    if not keys.intersection(_AXES):
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


def _keys(path: Path) -> set[str]:
    """Names of the header's fields, in small letters."""
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_BYTES)
    except OSError as error:
        raise MeshRefusedError(f"{path.name} cannot be opened: {error.strerror or error}.") from None
    keys = set()
    for line in start.split(b"\n"):
        field = re.match(rb"\s*([^=\0]+?)\s*=", line)
        if not field:
            break
        keys.add(field[1].decode(errors="replace").lower())
        if field[1].lower() == b"elementdatafile":
            break
    return keys
