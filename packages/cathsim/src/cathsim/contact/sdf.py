"""A vessel as a signed-distance grid with an introducer sheath, known to the native contact function by a number."""

from __future__ import annotations

import ctypes
import weakref
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.contact.native import address, library
from cathsim.lattice.node_blocks import LatticeStruct
from cathsim.lifetime_cache import kept_with_owner

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

MAGIC = 1129469011.0
GEOM_NAME, SHEATH_NAME = "vessel", "sheath"
LUMEN, SHEATH = 0, 1
SHEATH_RADIUS = 0.75e-3  # inner radius of the sheath of a bare wire, m


@dataclass(frozen=True, eq=False)
class Vessel:
    """The free space a wire moves in: a lumen, and the bore of a straight sheath behind the entry.

    In a MuJoCo model it is a dummy box geom for each (`add_to`); contacts come from the grid.
    """

    grid: SignedDistanceGrid  # signed distance to the wall, at least 3 x 3 x 3 nodes
    entry: np.ndarray  # where the sheath opens into the vessel, m. Shape (3,).
    direction: np.ndarray  # unit vector into the vessel. Shape (3,).
    sheath_radius: float = SHEATH_RADIUS  # inner radius of the sheath, m; 0 for no sheath
    sheath_overlap: float = 6.0e-3  # how far the bore reaches past `entry`, m
    sheath_flare: float = 0.0  # by how much the bore is wider at its mouth, m
    sheath_amid: bool = False  # whether the sheath lies amid the lumen and its bore holds what is in it
    number: int = field(init=False)

    def __post_init__(self) -> None:
        if min(self.grid.shape) < 3:
            raise ValueError(f"a vessel's grid needs at least 3 x 3 x 3 nodes, got shape {self.grid.shape}")
        direction = np.array(self.direction, float)
        if direction.shape != (3,) or abs(np.linalg.norm(direction) - 1) > 1e-6:
            raise ValueError(f"direction must be a unit vector of shape (3,), got {direction}")
        entry = np.array(self.entry, float)
        number = library().cathsim_vessel_register(
            ctypes.byref(LatticeStruct.of(self.grid.blocks)),
            address(self.grid.origin),
            float(self.grid.spacing),
            address(entry),
            address(direction),
            float(self.sheath_radius),
            float(self.sheath_flare),
            float(self.sheath_overlap),
            int(self.sheath_amid),
        )
        if number < 0:
            raise RuntimeError("4096 vessels are in use at once, the most there can be: release environments first")
        for name, value in (("entry", entry), ("direction", direction)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "number", number)
        weakref.finalize(self, library().cathsim_vessel_release, number)

    def add_to(self, spec: mujoco.MjSpec) -> mujoco.MjsGeom:
        """Adds the dummy geoms that stand for this vessel to a model under construction.

        The lumen's contacts have the wire's friction, the sheath's none. The model must not be stepped after this
        object is gone.

        Returns:
            The lumen's geom; the sheath's, if there is one, is named "sheath".
        """
        spec.nuser_geom = max(spec.nuser_geom, 3)
        lumen = self._add_geom(spec, GEOM_NAME, LUMEN)
        if self.sheath_radius > 0:
            sheath = self._add_geom(spec, SHEATH_NAME, SHEATH)
            sheath.condim, sheath.priority = 1, 2
            sheath.solref, sheath.solimp = [0.004, 1.0], [0.98, 0.998, 0.0002, 0.5, 2.0]
        return lumen

    def _add_geom(self, spec: mujoco.MjSpec, name: str, part: int) -> mujoco.MjsGeom:
        return spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[10.0, 10.0, 10.0],
            contype=1,
            conaffinity=0,
            condim=3,
            group=5,
            rgba=[0, 0, 0, 0],
            userdata=[MAGIC, float(self.number), float(part)],
        )

    def wall_parts(self, model: mujoco.MjModel) -> int:
        """How many geoms after the grid's stand for the wall: none, the grid itself makes the contacts."""
        return 0

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance as the contact function sees it, sheath included.

        Args:
            points: world positions, m. Shape (n, 3).

        Returns:
            Distances, m, positive in free space, shape (n,), and their gradients, shape (n, 3).
        """
        points = np.ascontiguousarray(np.atleast_2d(points), float)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points must have shape (n, 3), got {points.shape}")
        distances, gradients = np.empty(len(points)), np.empty_like(points)
        library().cathsim_vessel_distances(
            self.number, len(points), address(points), address(distances), address(gradients)
        )
        return distances, gradients


@kept_with_owner
def vessel_of(phantom: Phantom, entry: str, sheath_radius: float = SHEATH_RADIUS, sheath_flare: float = 0.0) -> Vessel:
    """The native vessel of a phantom with a sheath of an inner radius (m), wider at its mouth (m), at an entry.

    Raises:
        ValueError: the phantom has no such entry.
    """
    site = phantom.entry(entry)
    return Vessel(
        phantom.grid, site.position, site.direction, sheath_radius, sheath_flare=sheath_flare, sheath_amid=site.amid
    )
