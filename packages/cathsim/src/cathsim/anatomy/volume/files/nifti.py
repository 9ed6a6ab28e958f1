"""Label volumes and CTs in NIfTI files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.source import VolumeSource, disagreement, require_one_volume
from cathsim.anatomy.volume.files.values import BROKEN, in_words, read_values

SUFFIXES = (".nii", ".nii.gz")
TRANSFORMS = ("sform", "qform")
_UNKNOWN_UNIT = (
    0.02  # largest voxel's side in a file without a unit below which that is m: no voxel is that small in mm
)
_LABEL = re.compile(r'<Label\s[^>]*?Key="(\d+)"[^>]*>\s*(?:<!\[CDATA\[)?(.*?)(?:\]\]>)?\s*</Label>', re.DOTALL)


def open_nifti(path: Path, transform: str | None = None) -> VolumeSource:
    """Reads a NIfTI file's header.

    Names of labels come from the extension that TotalSegmentator and Connectome Workbench write.

    Args:
        path: of the file.
        transform: which of the header's two affines is taken, "sform" or "qform"; None: the sform where there is one.

    Raises:
        MeshRefusedError: it is damaged or no volume, has no such affine, or nibabel is missing.
    """
    try:
        import nibabel
    except ModuleNotFoundError:
        raise MeshRefusedError(f"{path.name} needs nibabel: pip install 'endonav-cathsim[volumes]'.") from None
    try:
        image: Any = nibabel.load(path)
        if not isinstance(image, nibabel.Nifti1Image):
            raise MeshRefusedError(
                f"{path.name} is no NIfTI file but one of the kind {type(image).__name__.removesuffix('Image')}; "
                "convert it to .nii.gz, as 3D Slicer and ITK-SNAP do."
            )
        header = image.header
        shape = tuple(int(n) for n in image.shape)
        affine, notes = _affine(path, header, shape, transform)
        unit = {"meter": "m", "mm": "mm", "micron": "micron"}.get(header.get_xyzt_units()[0], "")
        names = {(0, int(key)): text.strip() for key, text in _labels(header) if int(key) > 0}
    except MeshRefusedError:
        raise
    except nibabel.filebasedimages.ImageFileError as error:
        raise MeshRefusedError(
            f"{path.name} is no NIfTI file ({in_words(error)}); give a .nii or .nii.gz file."
        ) from None
    except (*BROKEN, nibabel.spatialimages.HeaderDataError, np.linalg.LinAlgError) as error:
        raise MeshRefusedError(f"{path.name} is damaged: {in_words(error)}; copy or export it again.") from None
    three = require_one_volume(path, shape)
    if not unit:
        sides = np.linalg.norm(affine[:3, :3], axis=0)
        unit = "m" if np.isfinite(sides).all() and 0 < sides.max() < _UNKNOWN_UNIT else "mm"
    proxy: Any = image.dataobj
    kind = np.dtype(proxy.dtype)
    if kind.kind not in "iuf":
        raise MeshRefusedError(
            f"{path.name} holds values of the kind {kind}, expected numbers; export one number a voxel."
        )

    packing = "gzip" if path.name.lower().endswith(".gz") else ""

    def values() -> NDArray:
        return read_values(path, kind, three, packing, skip=int(proxy.offset))[None]

    scale = (float(proxy.slope), float(proxy.inter))
    return VolumeSource(path, three, affine, "RAS", unit, kind.itemsize, values, names=names, notes=notes, scale=scale)


def _affine(
    path: Path, header: Any, shape: tuple[int, ...], transform: str | None
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """The affine that counts, and notes on what else the header says."""
    codes = {name: int(header[f"{name}_code"]) for name in TRANSFORMS}
    transform_names = [name for name in TRANSFORMS if codes[name] > 0]
    if transform is not None and transform not in transform_names:
        raise MeshRefusedError(f"{path.name} has no {transform}; leave transform={transform!r} out.")
    if not transform_names:
        note = "the file says nothing of the patient's axes: its voxels' order is taken for left, front, up"
        return np.asarray(header.get_best_affine(), dtype=np.float64), (note,)
    affines = {name: np.asarray(getattr(header, f"get_{name}")(), dtype=np.float64) for name in transform_names}
    taken = transform or transform_names[0]
    affine = affines[taken]
    three = (*shape, 1, 1, 1)[:3]
    notes = []
    for other in transform_names:
        if other != taken and (apart := disagreement(affine, affines[other], three)):
            mirrored = np.linalg.det(affine[:3, :3]) * np.linalg.det(affines[other][:3, :3]) < 0
            sides = " and exchange two sides of the patient" if mirrored else ""
            notes.append(
                f"the header's sform and qform lie up to {apart:.3g} apart{sides}: the {taken} is taken, "
                f"transform={other!r} takes the other"
            )
    sides = np.linalg.norm(affine[:3, :3], axis=0)
    pitch = np.abs(np.asarray(header["pixdim"][1:4], dtype=np.float64))
    scaled = affine.copy()
    scaled[:3, :3] *= pitch / np.where(sides > 0, sides, 1.0)
    if disagreement(affine, scaled, three):
        notes.append(f"the header's spacing {_listed(pitch)} is not that of its axes, {_listed(sides)}, which is taken")
    return affine, tuple(notes)


def _listed(sides: NDArray[np.float64]) -> str:
    return " x ".join(f"{side:.5g}" for side in sides)


def _labels(header: Any) -> list[tuple[str, str]]:
    """Numbers and names of labels in a header's extensions."""
    labels = []
    for extension in header.extensions:
        content = extension.get_content()
        text = content.decode("utf-8", errors="replace") if isinstance(content, bytes) else str(content)
        labels += _LABEL.findall(text)
    return labels
