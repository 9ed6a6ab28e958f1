"""A vessel whose wall is convex hulls, lids and a sheath of boxes: geometry that any MuJoCo collides by itself."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import mujoco
import numpy as np

from cathsim.anatomy import Phantom
from cathsim.anatomy.entry import read_point
from cathsim.anatomy.surface import open_ends
from cathsim.contact.hulls import Decomposition, Hull, wall_hulls
from cathsim.contact.sdf import GEOM_NAME, SHEATH_NAME, Vessel

HULL_NAME, LID_NAME = "hull{}", "lid{}"
BORE_SIDES = 6  # boxes around the sheath's bore
BORE_WALL = 5.0e-3  # thickness of those boxes, m
LID_THICKNESS = 3.0e-3  # m
LID_BORE = 1.2e-3  # the lid around the sheath stays clear of the wire, m
WALL_COLOUR = [0.82, 0.45, 0.42, 0.35]


@dataclass(frozen=True, eq=False)
class HullVessel(Vessel):
    """A vessel with convex hulls for a wall.

    Its distance grid produces no contacts: it only says how deep a wire lies in the true wall.
    """

    hulls: tuple[Hull, ...] = ()  # convex parts of the wall, m, world frame
    # centre (3,) m, outward unit normal (3,) and radius m of the vessel's open ends
    openings: tuple[tuple[np.ndarray, np.ndarray, float], ...] = ()
    sheath_length: float = 1.0  # m

    def add_to(self, spec: mujoco.MjSpec) -> mujoco.MjsGeom:
        """Adds the wall and the sheath to a model under construction.

        Returns:
            The geom of the distance grid, which collides with nothing; a portable model does without it.
        """
        spec.nuser_geom = max(spec.nuser_geom, 3)
        grid = self._add_geom(spec, GEOM_NAME, 0)
        grid.contype = 0
        for index, hull in enumerate(self.hulls):
            name = HULL_NAME.format(index)
            spec.add_mesh(
                name=name,
                uservert=np.asarray(hull.vertices, np.float32).ravel(),
                userface=np.asarray(hull.faces, np.int32).ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # slivers have no volume to speak of
            )
            _add_wall(spec, name, mujoco.mjtGeom.mjGEOM_MESH).meshname = name
        for index, (centre, normal, radius) in enumerate(self.openings):
            if np.linalg.norm(centre - self.entry) > radius:
                lid = _add_wall(spec, LID_NAME.format(index), mujoco.mjtGeom.mjGEOM_CYLINDER)
                lid.size, lid.pos, lid.quat = [radius, LID_THICKNESS / 2, 0], centre + 0.5e-3 * normal, _turned(normal)
            else:  # the opening that the wire comes in through is closed around the sheath
                end = max(0.0, float((centre - self.entry) @ self.direction)) + 0.5e-3
                self._add_bore(spec, LID_NAME.format(index), LID_BORE, radius, LID_THICKNESS, end)
        self._add_bore(spec, SHEATH_NAME, self.sheath_radius, BORE_WALL, self.sheath_length, 0.0)
        return grid

    def _add_bore(
        self, spec: mujoco.MjSpec, name: str, inner: float, thickness: float, length: float, end: float
    ) -> None:
        """A prismatic bore along the sheath's axis that ends so far beyond the entry, of boxes that overlap."""
        width = (inner + thickness) * np.tan(np.pi / BORE_SIDES)
        along = _turned(self.direction)
        for side in range(BORE_SIDES):
            turn, rotation = np.zeros(4), np.zeros(9)
            mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), 2 * np.pi * side / BORE_SIDES)
            quaternion = np.zeros(4)
            mujoco.mju_mulQuat(quaternion, along, turn)
            mujoco.mju_quat2Mat(rotation, quaternion)
            outward = rotation.reshape(3, 3)[:, 0]
            box = _add_wall(spec, f"{name}{side}", mujoco.mjtGeom.mjGEOM_BOX)
            box.size = [thickness / 2, width, length / 2]
            box.pos = self.entry + (end - length / 2) * self.direction + (inner + thickness / 2) * outward
            box.quat = quaternion
            if name == SHEATH_NAME:
                box.condim, box.priority = 1, 2
                box.solref, box.solimp = [0.004, 1.0], [0.98, 0.998, 0.0002, 0.5, 2.0]

    def wall_parts(self, model: mujoco.MjModel) -> int:
        """How many geoms after the grid's stand for the wall, those of the sheath left out."""
        return int(model.geom(f"{SHEATH_NAME}0").id - model.geom(GEOM_NAME).id - 1)


def _add_wall(spec: mujoco.MjSpec, name: str, kind: mujoco.mjtGeom) -> mujoco.MjsGeom:
    """A part of the wall, met by the wire alone; contacts have the wire's friction and stiffness."""
    return spec.worldbody.add_geom(name=name, type=kind, contype=1, conaffinity=0, condim=3, group=3, rgba=WALL_COLOUR)


def _turned(direction: np.ndarray) -> np.ndarray:
    """Quaternion that turns +z into a direction."""
    quaternion = np.zeros(4)
    mujoco.mju_quatZ2Vec(quaternion, np.asarray(direction, float))
    return quaternion


@functools.lru_cache(maxsize=32)
def hull_vessel(phantom: Phantom, entry: str, settings: Decomposition) -> HullVessel:
    """The vessel of a phantom with convex hulls for a wall and a sheath at one of its entries.

    Raises:
        ValueError: the phantom has no such entry, or it is a point amid the lumen.
        ImportError: CoACD is needed and not installed.
    """
    site, grid = phantom.entry(entry), phantom.grid
    if read_point(entry) is not None:
        raise ValueError("contact='hulls' needs an entry at an open end, whose sheath no wall crosses: name one")
    hulls = wall_hulls(phantom, settings)
    inset = 1.5 * max(settings.lattice, grid.spacing)  # so far inside the caps the wall is cut open
    openings = tuple(
        (centre - inset * normal, normal, radius + settings.thickness)
        for centre, normal, radius in open_ends(phantom.tree)
    )
    return HullVessel(grid, site.position, site.direction, hulls=tuple(hulls), openings=openings)
