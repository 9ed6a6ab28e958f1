"""Variants of label volumes (NIfTI) for the benchmark of imports: what surfaces' variants are, said of voxels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.volume.files.nifti import SUFFIXES
from cathsim.anatomy.volume.files.reading import volume_files

TORN = 0.01  # share of the labelled voxels, or of a surface's faces, that is missing
HEADER_UNITS = {"m": ("meter", 1e-3), "micron": ("micron", 1e3), "mm": ("mm", 1.0)}  # name, and how many in one mm

Labels = NDArray[Any]
Affine = NDArray[np.float64]
Volume = tuple[Labels, Affine]


def rotated(volume: Volume, generator: np.random.Generator) -> Volume:
    """The affine turned at random: all rotations are as likely."""
    turn, _ = np.linalg.qr(generator.standard_normal((3, 3)))
    turn[:, 0] *= np.linalg.det(turn)
    return volume[0], _world(turn) @ volume[1]


def mirrored(volume: Volume, generator: np.random.Generator) -> Volume:
    """Left and right exchanged."""
    return volume[0], _world(np.diag([-1.0, 1.0, 1.0])) @ volume[1]


def flipped(volume: Volume, generator: np.random.Generator) -> Volume:
    """Voxels stored the other way round along each axis, at the same places."""
    labels, affine = volume
    return labels[::-1, ::-1, ::-1], _stored(affine, np.full(3, -1.0), np.array(labels.shape) - 1.0)


def torn(volume: Volume, generator: np.random.Generator) -> Volume:
    """Labelled voxels missing, drawn at random."""
    labels, affine = volume
    return np.where((labels > 0) & (generator.random(labels.shape) < TORN), 0, labels).astype(labels.dtype), affine


def decimated(volume: Volume, generator: np.random.Generator) -> Volume:
    """Every second voxel along each axis: an eighth of them."""
    return volume[0][::2, ::2, ::2], _stored(volume[1], np.full(3, 2.0), np.zeros(3))


def subdivided(volume: Volume, generator: np.random.Generator) -> Volume:
    """Each voxel in eight."""
    labels = volume[0]
    for axis in range(3):
        labels = np.repeat(labels, 2, axis=axis)
    return labels, _stored(volume[1], np.full(3, 0.5), np.full(3, -0.25))


def _world(linear: Affine) -> Affine:
    whole: Affine = np.eye(4)
    whole[:3, :3] = linear
    return whole


def _stored(affine: Affine, steps: Affine, first: Affine) -> Affine:
    """The affine of a lattice whose first voxel and steps are given in indices of the one before."""
    new: Affine = np.diag([*steps, 1.0])
    new[:3, 3] = first
    return affine @ new


CHANGES: dict[str, Callable[[Volume, np.random.Generator], Volume]] = {
    change.__name__: change for change in (rotated, mirrored, flipped, torn, decimated, subdivided)
}
VARIANTS = ("rotated", "mirrored", *HEADER_UNITS, "flipped", "torn", "decimated", "subdivided")


def is_volume(path: Path) -> bool:
    """Whether variants of it can be written: a NIfTI file in mm, or a folder of them."""
    return bool(volume_files(path)) if path.is_dir() else path.name.lower().endswith(SUFFIXES)


def write_volume_variant(path: Path, variant: str, folder: Path, seed: int) -> Path:
    """Writes a variant of a file in mm, or of each file of a folder, with the labels and their names as before."""
    import nibabel

    if path.is_dir():
        inner = folder / path.name
        inner.mkdir(exist_ok=True)
        for file in volume_files(path):
            write_volume_variant(file, variant, inner, seed)
        return inner
    image: Any = nibabel.load(path)
    volume = np.asarray(image.dataobj), np.asarray(image.affine, np.float64)
    name, scale = HEADER_UNITS.get(variant, HEADER_UNITS["mm"])
    if variant in CHANGES:
        volume = CHANGES[variant](volume, np.random.default_rng(seed))
    changed = nibabel.Nifti1Image(volume[0], _world(scale * np.eye(3)) @ volume[1])
    changed.header.set_xyzt_units(name)
    changed.header.extensions.extend(image.header.extensions)
    file = folder / path.name
    nibabel.save(changed, file)
    return file
