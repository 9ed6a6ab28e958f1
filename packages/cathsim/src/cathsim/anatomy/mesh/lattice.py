"""Voxel lattices and the cost limits of an import: how fine one must and may be, and short distances on it."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError

_ACROSS = 36  # voxels across the widest place of a lumen ...
_FINEST, _COARSEST = 2.5e-4, 7e-4  # m, ... within these limits, the upper one at a resolution of 1 mm
_MOST_VOXELS = 45e6
_LAST_RESORT = 1.25e-3  # m: beyond it, thin vessels are lost
FOLLOWED = 2.5  # voxels of radius below which a vessel is too narrow to be followed

Mask = NDArray[np.bool_]


MOST_SECONDS = 120.0  # s of processor time; whole arches take 4 to 15, a tree from groin to head 40
MOST_BYTES = 1.5e9
VOXEL_BYTES = 25  # of every voxel of the lattice, all steps' arrays together at their peak
_VOXEL_SECONDS = 1.2e-6  # of processor time that every voxel of the lattice takes, all steps together
_LONG = 5.0  # s
SAMPLE_BYTES = 200  # of every point on the surface, its place in the search tree included


def lattice_spacing(
    width: float, sides: NDArray[np.float64], resolution: float, budget: Budget, unit: str
) -> tuple[float, tuple[str, ...]]:
    """Chooses m between voxels for a lumen of a width (m, of its widest ball) in a box of sides (3,) m.

    Returns:
        The ideal spacing, or, where that would take too much memory, what fits, with a note.

    Raises:
        MeshRefusedError: the box is too large for any.
    """
    ideal_spacing = float(np.clip(width / _ACROSS, _FINEST, max(_COARSEST, resolution / 2)))
    box_volume = float(np.prod(sides + 8 * ideal_spacing))
    spacing = max(ideal_spacing, min((box_volume / _MOST_VOXELS) ** (1 / 3), _LAST_RESORT))
    size = " x ".join(f"{1e3 * side:.4g}" for side in sides)
    budget.check_lattice(box_volume / spacing**3, spacing, f"{size} mm in {unit}")
    if spacing == ideal_spacing:
        return spacing, ()
    note = (
        f"its voxels are {1e3 * spacing:.2g} mm wide instead of {1e3 * ideal_spacing:.2g}, since the surface is large"
    )
    return spacing, (f"{note}: vessels narrower than {2e3 * FOLLOWED * spacing:.2g} mm may be lost",)


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


def dilated(mask: Mask) -> Mask:
    """A mask (nx, ny, nz) with the voxels that share a face with it; far cheaper than scipy's dilation."""
    grown = mask.copy()
    for axis in range(3):
        before, after = np.moveaxis(mask, axis, 0), np.moveaxis(grown, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return grown


@dataclass(eq=False)
class Budget:
    """The budget of one import; its clock runs from its making."""

    seconds: float = MOST_SECONDS  # s of processor time, checked between steps
    memory: float = MOST_BYTES  # bytes; checked before lattices and points are made
    _began: float = field(default_factory=time.thread_time, init=False)

    def check_time(self, step: str) -> None:
        """Raises `MeshRefusedError` once the time is spent, before a step such as "finding its ends".

        On a terminal, steps of an import that takes long are told on stderr.
        """
        spent = time.thread_time() - self._began
        if spent > _LONG and sys.stderr.isatty():
            sys.stderr.write(f"the import is {step} after {spent:.0f} s\n")
        if spent > self.seconds:
            raise MeshRefusedError(
                f"the import has taken the {self.seconds:g} s of processor time it may take, before {step}; repair the "
                "mesh (holes, loose sheets), cut it to the arch and its branches, or take a coarser resolution."
            )

    def check_lattice(self, voxels: float, spacing: float, size: str) -> None:
        """Raises `MeshRefusedError` for too many voxels, `spacing` (m) apart, over a surface of a `size` in words.

        On a terminal, an import that will take long is told on stderr with its time.
        """
        if not voxels * VOXEL_BYTES <= self.memory:
            raise MeshRefusedError(
                f"at {2e3 * spacing:g} mm this surface is too large ({size}): the import would take "
                f"{voxels * VOXEL_BYTES / 1e9:.3g} GB, it may take {self.memory / 1e9:g}; check its unit, or cut it "
                "to the arch and its branches."
            )
        seconds = _VOXEL_SECONDS * voxels
        if seconds > _LONG and sys.stderr.isatty():
            sys.stderr.write(f"the import takes about {seconds:.0f} s at this resolution\n")

    def check_samples(self, points: float) -> None:
        """Raises `MeshRefusedError` for a surface whose triangles would take too many points."""
        if not points * SAMPLE_BYTES <= self.memory:
            raise MeshRefusedError(
                f"the surface's triangles are too many and too large for a vessel's wall: the import would take "
                f"{points * SAMPLE_BYTES / 1e9:.3g} GB, it may take {self.memory / 1e9:g}; remove repeated and "
                "crossing sheets, fill its holes, or remesh it evenly."
            )
