"""Voxels that a resampling by whole numbers has repeated: they are joined, as they were before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.volume.files.reading import LabelVolume

_LEAST_CHANGES = 8  # between slices along an axis, that tell how often slices are repeated


def join_repeated(volume: LabelVolume) -> LabelVolume:
    """A volume in which voxels that are equal in groups along an axis are one voxel each.

    Labels that a program has copied to finer voxels have steps as high as the voxels before. What smooths them takes
    the height of a step from the size of the voxels, so that thin vessels would fall apart.

    Args:
        volume: labels.

    Returns:
        The same labels on the coarsest lattice that holds them without any change, with a note; the same volume where
        nothing is repeated.
    """
    times = np.array([_repeats(volume, axis) for axis in range(3)])
    if (times == 1).all():
        return volume
    affine = volume.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ ((times - 1) / 2)
    affine[:3, :3] *= times
    sides = " x ".join(f"{1e3 * side:.3g}" for side in np.linalg.norm(affine[:3, :3], axis=0))
    return replace(
        volume,
        vessels=np.ascontiguousarray(volume.vessels[:: times[0], :: times[1], :: times[2]]),
        affine=affine,
        first=_divided(volume.first, times),
        shape=_divided(volume.shape, times),
        notes=(*volume.notes, f"voxels repeat each other, as copying to finer ones does: taken as {sides} mm"),
    )


def _repeats(volume: LabelVolume, axis: int) -> int:
    """How many slices along an axis, counted from the volume's first on, are always equal."""
    slices = np.moveaxis(volume.vessels, axis, 0)
    changes = [i for i in range(1, len(slices)) if not np.array_equal(slices[i - 1], slices[i])]
    if len(changes) < _LEAST_CHANGES:
        return 1
    first = volume.first[axis]
    ends = [first, first + len(slices), volume.shape[axis]]
    return int(np.gcd.reduce([*(first + i for i in changes), *ends]))


def _divided(numbers: tuple[int, int, int], times: NDArray[np.int64]) -> tuple[int, int, int]:
    x, y, z = (int(n) // int(k) for n, k in zip(numbers, times, strict=True))
    return x, y, z
