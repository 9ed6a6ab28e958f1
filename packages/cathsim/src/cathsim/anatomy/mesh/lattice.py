"""Voxel lattices: how fine one must be for a lumen, and short distances on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.budget import Budget

_ACROSS = 36  # voxels across the widest place of a lumen ...
_FINEST, _COARSEST = 2.5e-4, 7e-4  # m, ... within these limits, the upper one at a resolution of 1 mm
_MOST_VOXELS = 45e6
_LAST_RESORT = 1.2e-3  # m: beyond it, thin vessels are lost

Mask = NDArray[np.bool_]


def lattice_spacing(width: float, sides: NDArray[np.float64], resolution: float, budget: Budget, unit: str) -> float:
    """Chooses m between voxels for a lumen of a width (m, of its widest ball) in a box of sides (3,) m.

    Raises:
        MeshRefusedError: the box is too large for any.
    """
    spacing = float(np.clip(width / _ACROSS, _FINEST, max(_COARSEST, resolution / 2)))
    room = float(np.prod(sides + 8 * spacing))
    spacing = max(spacing, min((room / _MOST_VOXELS) ** (1 / 3), max(_LAST_RESORT, resolution / 2)))
    size = " x ".join(f"{1e3 * side:.4g}" for side in sides)
    budget.check_lattice(room / spacing**3, spacing, f"{size} mm in {unit}")
    return spacing


def short_distance(mask: Mask, reach: int) -> NDArray[np.uint8]:
    """Squared distance in voxels of every voxel to the nearest of a mask, up to a reach of at most 8; beyond, 255.

    Exact where it is not 255, and far cheaper than a whole distance transform.
    """
    assert 1 <= reach <= 8
    squared = np.where(mask, np.uint8(0), np.uint8(255))
    for axis in range(3):
        before = np.moveaxis(squared, axis, 0)
        after = before.copy()
        for step in range(1, reach + 1):
            if step >= before.shape[0]:
                break
            # saturates: 255 stays "far"
            near = np.minimum(before, np.uint8(255 - step * step)) + np.uint8(step * step)
            np.minimum(after[step:], near[:-step], out=after[step:])
            np.minimum(after[:-step], near[step:], out=after[:-step])
        squared = np.moveaxis(after, 0, axis)
    squared = np.ascontiguousarray(squared)
    squared[squared > reach * reach] = 255
    return squared
