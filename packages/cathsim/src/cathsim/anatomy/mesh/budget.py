"""The cost limits of one import of a mesh: processor time and memory."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

from cathsim.anatomy.mesh.report import MeshRefusedError

MOST_SECONDS = 120.0  # s of processor time; whole arches take 4 to 15, a tree from groin to head 40
MOST_BYTES = 1.5e9
VOXEL_BYTES = 25  # of every voxel of the lattice, all steps' arrays together at their peak
_LONG = 5.0  # s
SAMPLE_BYTES = 200  # of every point on the surface, its place in the search tree included


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
        """Raises `MeshRefusedError` for too many voxels, `spacing` (m) apart, over a surface of a `size` in words."""
        if not voxels * VOXEL_BYTES <= self.memory:
            raise MeshRefusedError(
                f"at {2e3 * spacing:g} mm this surface is too large ({size}): the import would take "
                f"{voxels * VOXEL_BYTES / 1e9:.3g} GB, it may take {self.memory / 1e9:g}; check its unit, cut it to "
                "the arch and its branches, or take a coarser resolution."
            )

    def check_samples(self, points: float) -> None:
        """Raises `MeshRefusedError` for a surface whose triangles would take too many points."""
        if not points * SAMPLE_BYTES <= self.memory:
            raise MeshRefusedError(
                f"the surface's triangles are too many and too large for a vessel's wall: the import would take "
                f"{points * SAMPLE_BYTES / 1e9:.3g} GB, it may take {self.memory / 1e9:g}; remove repeated and "
                "crossing sheets, fill its holes, or remesh it evenly."
            )
