"""A volume's file before its voxels are read: axes, size, names of labels, and its values slab by slab."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError

LARGEST = 2_000_000_000  # bytes of a volume that is read at all
_SLAB_BYTES = 1 << 23
UNIT_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "micron": 1e-6, "um": 1e-6, "inch": 0.0254}
_THINNEST, _THICKEST = 2e-5, 2e-2  # m, sides of a voxel
_LEAST_SIDES = 4  # voxels along every axis
_MOST_SHEAR = 0.05  # cosine of the angle between two of the volume's axes
_ROUNDING = 1e-6  # cosine of such an angle that is none
_NOTED = 0.5  # of a voxel's smallest side by which two headers may place a corner apart without a note
NO_VOXEL_SIZE = "the file does not say how large its voxels are along each axis: 1 mm is taken"
SIDES = ("LR", "PA", "SI")  # letters of a world's axes: of the patient's left, posterior and superior axis first

Array = NDArray[np.float64]
Slab = tuple[int, NDArray]  # first index along the last axis, and values (layers, nx, ny, k)


@dataclass(frozen=True, eq=False)
class VolumeSource:
    """One volume's file."""

    path: Path
    shape: tuple[int, int, int]  # voxels along the file's axes
    affine: Array  # (4, 4) from a voxel's indices to the file's world, in the file's unit
    world: str  # axes of the file's world: "RAS" (NIfTI), "LPS" (DICOM), or other letters of SIDES
    unit: str  # of the file's world
    itemsize: int  # bytes of a value
    values: Callable[[], NDArray]  # reads the values (layers, nx, ny, nz) as they are stored
    layers: int = 1  # volumes in the file, whose labels may overlap
    # names of labels by layer and value, as the file gives them
    names: dict[tuple[int, int], str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    scale: tuple[float, float] = (1.0, 0.0)  # factor and summand of the stored values

    def __post_init__(self) -> None:
        check_geometry(self.path, self.shape, self.affine, UNIT_METRES[self.unit])
        straight = straightened(self.affine, self.shape)
        if apart := disagreement(straight, self.affine, self.shape):
            note = f"the file's axes are not quite at right angles: they are straightened, corners move by {apart:.2g}"
            object.__setattr__(self, "notes", (*self.notes, f"{note} {self.unit}"))
        object.__setattr__(self, "affine", straight)
        size = float(math.prod(self.shape)) * self.layers * self.itemsize
        if size > LARGEST:
            raise MeshRefusedError(
                f"{self.path.name} holds {size / 1e9:.1f} GB of values, at most {LARGEST / 1e9:g} GB are read; cut it "
                "to the chest, or save it with fewer bytes a voxel."
            )

    def slabs(self) -> Iterator[Slab]:
        """Reads the values, some slices after the other from the first on, so that what is made of them stays small."""
        values, (factor, summand) = self.values(), self.scale
        step = max(1, int(_SLAB_BYTES // values[..., 0].nbytes))
        for first in range(0, values.shape[-1], step):
            slab = values[..., first : first + step]
            yield first, slab if self.scale == (1.0, 0.0) else slab * factor + summand

    @property
    def metres(self) -> float:
        """m per unit of the file's world."""
        return UNIT_METRES[self.unit]

    @property
    def spacing(self) -> Array:
        """(3,) m between voxels along the file's axes."""
        return np.linalg.norm(self.affine[:3, :3], axis=0) * self.metres

    @property
    def frame(self) -> Array:
        """(3, 3) rows are the patient's left, posterior and superior axis in the file's world."""
        return np.array([[float((axis == side[0]) - (axis == side[1])) for axis in self.world] for side in SIDES])


def require_one_volume(path: Path, sizes: Sequence[int], components: int = 1) -> tuple[int, int, int]:
    """The three sizes of a volume, without further axes of one.

    Args:
        sizes: of all axes of the file.
        components: values a voxel.

    Raises:
        MeshRefusedError: it is a series, a slice, or has several values a voxel.
    """
    sizes = [int(size) for size in sizes]
    while len(sizes) > 3 and sizes[-1] == 1:
        sizes = sizes[:-1]
    if len(sizes) != 3:
        raise MeshRefusedError(
            f"{path.name} has {len(sizes)} axes ({' x '.join(map(str, sizes))}), expected a volume of three; save one "
            "volume of the series as its own file."
        )
    if components != 1:
        raise MeshRefusedError(
            f"{path.name} has {components} values a voxel, expected one label; save one of them as its own file."
        )
    return sizes[0], sizes[1], sizes[2]


def corners(affine: Array, shape: Sequence[int]) -> Array:
    """(8, 3) places of a volume's corner voxels in the file's world."""
    at = np.array(list(itertools.product(*((0, size - 1) for size in shape))), dtype=np.float64)
    return at @ affine[:3, :3].T + affine[:3, 3]


def farthest_apart(one: Array, other: Array, shape: Sequence[int]) -> float:
    """How far two affines (4, 4) place a corner of a volume apart, in the unit of the file's world."""
    return float(np.linalg.norm(corners(one, shape) - corners(other, shape), axis=1).max())


def disagreement(one: Array, other: Array, shape: Sequence[int]) -> float:
    """`farthest_apart`, 0 where that is less than half a voxel."""
    apart = farthest_apart(one, other, shape)
    return apart if apart > _NOTED * float(np.min(np.linalg.norm(one[:3, :3], axis=0))) else 0.0


def straightened(affine: Array, shape: Sequence[int]) -> Array:
    """The affine (4, 4) with the nearest axes at right angles, of the same lengths, about the volume's middle."""
    sides = np.linalg.norm(affine[:3, :3], axis=0)
    axes = affine[:3, :3] / sides
    if np.abs(axes.T @ axes - np.eye(3)).max() < _ROUNDING:
        return affine
    left, _, right = np.linalg.svd(axes)
    straight = affine.copy()
    straight[:3, :3] = left @ right * sides
    middle = (np.array(shape, dtype=np.float64) - 1) / 2
    straight[:3, 3] += (affine[:3, :3] - straight[:3, :3]) @ middle
    return straight


def check_geometry(path: Path, shape: tuple[int, ...], affine: Array, metres: float) -> None:
    """Refuses a volume that is flat, or whose affine is none.

    Args:
        affine: (4, 4) from indices to a world of `metres` per unit.
    """
    if min(shape) < _LEAST_SIDES:
        raise MeshRefusedError(
            f"{path.name} has {' x '.join(map(str, shape))} voxels, expected a volume of at least {_LEAST_SIDES} along "
            "every axis; export the whole segmentation, not a slice."
        )
    if affine.shape != (4, 4) or not np.isfinite(affine).all():
        raise MeshRefusedError(
            f"{path.name} has an affine with missing or infinite numbers; save it again with its axes."
        )
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    if spacing.min() <= 0 or abs(np.linalg.det(affine[:3, :3])) < 1e-3 * np.prod(spacing):
        raise MeshRefusedError(
            f"{path.name} has an affine that is none: its axes {np.round(affine[:3, :3], 4).tolist()} do not span "
            "space; save the volume again with its axes."
        )
    axes = affine[:3, :3] / spacing
    shear = float(np.abs(axes.T @ axes - np.eye(3)).max())
    if shear > _MOST_SHEAR:
        raise MeshRefusedError(
            f"{path.name} has axes that are not at right angles ({np.degrees(np.arccos(shear)):.0f} degrees), as a "
            "tilted gantry leaves them; resample it to right angles."
        )
    spacing = spacing * metres
    if not (spacing.min() >= _THINNEST and spacing.max() <= _THICKEST):
        sides = " x ".join(f"{1e3 * side:.3g}" for side in spacing)
        raise MeshRefusedError(
            f"{path.name} has voxels of {sides} mm, expected {1e3 * _THINNEST:g} to {1e3 * _THICKEST:g} mm; correct "
            "the unit in its header, or the affine."
        )
