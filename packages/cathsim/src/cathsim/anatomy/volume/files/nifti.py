"""Label volumes and CTs in NIfTI files, read slab by slab."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.source import Slab, VolumeSource, require_one_volume

SUFFIXES = (".nii", ".nii.gz")
SLAB_BYTES = 1 << 23
BROKEN = (OSError, EOFError, ValueError, KeyError, TypeError, IndexError, OverflowError, MemoryError, zlib.error)
_UNKNOWN_UNIT = (
    0.02  # largest voxel's side in a file without a unit below which that is m: no voxel is that small in mm
)
_LABEL = re.compile(r'<Label\s[^>]*?Key="(\d+)"[^>]*>\s*(?:<!\[CDATA\[)?(.*?)(?:\]\]>)?\s*</Label>', re.DOTALL)


def open_nifti(path: Path) -> VolumeSource:
    """Reads a NIfTI file's header.

    Names of labels come from the extension that TotalSegmentator and Connectome Workbench write.

    Raises:
        MeshRefusedError: it is damaged or no volume, or nibabel is missing.
    """
    try:
        import nibabel
    except ModuleNotFoundError:
        raise MeshRefusedError(f"{path.name} needs nibabel: pip install 'endonav-cathsim[volumes]'.") from None
    try:
        image: Any = nibabel.load(path)
        header = image.header
        shape = tuple(int(n) for n in image.shape)
        codes = int(header["sform_code"]), int(header["qform_code"])
        affine = np.asarray(image.affine, dtype=np.float64)
        unit = {"meter": "m", "mm": "mm", "micron": "micron"}.get(header.get_xyzt_units()[0], "")
        names = {(0, int(key)): text.strip() for key, text in _labels(header) if int(key) > 0}
    except nibabel.filebasedimages.ImageFileError as error:
        raise MeshRefusedError(f"{path.name} is no NIfTI file ({error}); give a .nii or .nii.gz file.") from None
    except (*BROKEN, nibabel.spatialimages.HeaderDataError, np.linalg.LinAlgError) as error:
        raise MeshRefusedError(f"{path.name} is damaged: {_told(error)}; copy or export it again.") from None
    notes: tuple[str, ...] = ()
    three = require_one_volume(path, shape)
    if not any(codes):
        notes += ("the file says nothing of the patient's axes: its voxels' order is taken for right, front, up",)
    if not unit:
        sides = np.linalg.norm(affine[:3, :3], axis=0)
        unit = "m" if np.isfinite(sides).all() and 0 < sides.max() < _UNKNOWN_UNIT else "mm"
    proxy = image.dataobj
    kind = np.dtype(proxy.dtype)
    if kind.kind not in "iuf":
        raise MeshRefusedError(
            f"{path.name} holds values of the kind {kind}, expected numbers; export one number a voxel."
        )

    def slabs() -> Iterator[Slab]:
        slope, inter = float(proxy.slope), float(proxy.inter)
        step = max(1, int(SLAB_BYTES // (three[0] * three[1] * kind.itemsize)))
        try:
            with nibabel.openers.ImageOpener(image.file_map["image"].filename or str(path)) as file:
                file.seek(int(proxy.offset))
                for first in range(0, three[2], step):
                    count = min(step, three[2] - first)
                    content = file.read(count * three[0] * three[1] * kind.itemsize)
                    values = np.frombuffer(content, dtype=kind).reshape((three[0], three[1], count), order="F")
                    yield first, (values if slope == 1.0 and inter == 0.0 else values * slope + inter)[None]
        except BROKEN as error:
            raise MeshRefusedError(f"{path.name} is damaged: {_told(error)}; copy or export it again.") from None

    return VolumeSource(path, three, affine, "RAS", unit, kind.itemsize, slabs, names=names, notes=notes)


def _labels(header: Any) -> list[tuple[str, str]]:
    """Numbers and names of labels in a header's extensions."""
    found = []
    for extension in header.extensions:
        content = extension.get_content()
        text = content.decode("utf-8", errors="replace") if isinstance(content, bytes) else str(content)
        found += _LABEL.findall(text)
    return found


def _told(error: BaseException) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
