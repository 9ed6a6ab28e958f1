"""The local roadmap: a scan taken before the procedure, at the tip and in the tip's own frame."""

from __future__ import annotations

import ctypes
import math
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from cathsim.anatomy.point_target import TargetLike, as_target
from cathsim.contact.native import address, library
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import TIP_SITE
from cathsim.lattice.node_blocks import LatticeStruct
from cathsim.observations.scan import Scan
from cathsim.simulation import Simulation
from cathsim.validation import Unit, quantity

PATH_STEP = 1e-3  # m between the points of the way that is followed
PATH_ARCS = np.array([3, 6, 10, 16, 24, 36, 50]) * 1e-3  # m ahead of the tip: the points of the way that are shown
WIRE_ARCS = np.array([4, 8, 12, 20, 30, 45, 60]) * 1e-3  # m behind the tip: the points of the wire that are shown
CLEARANCE = 2e-3  # m: the way is nudged off walls nearer than this
RAY_LIMIT = 0.03  # m
RAY_SCALE, REMAINING_SCALE, NEAR_SCALE, INSERTION_SCALE = 0.015, 0.2, 0.02, 0.2  # m
LEAD_SCALE = 0.02  # m
# devices that reach farther than FAR are shown the way in a tree as that in an arch: at most AHEAD of it, the insertion
# of a way of ARCH, and a lead within LEADS, m; what policies see lies where they were trained
FAR, AHEAD, ARCH, LEADS = 0.6, 0.15, 0.28, (-0.06, 0.12)
SPEED_SCALE, FORCE_SCALE = 0.02, 0.05  # m/s, N

# Directions of the rays in the tip's frame: ahead, four askew, four across.
RAYS = np.array(
    [(0, 0, 1)]
    + [(x, y, 1) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    + [(x, y, 0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))],
    float,
)
RAYS /= np.linalg.norm(RAYS, axis=1, keepdims=True)

ROADMAP_SIZE = 3 * len(PATH_ARCS) + 3 * len(WIRE_ARCS) + len(RAYS) + 13  # with one device
_OF_PAIR = 7  # more with two


_Noise = Annotated[float, Interval(ge=0, le=0.1), Unit("m")]


class _RoadmapStruct(ctypes.Structure):
    """struct Roadmap of roadmap.c."""

    _fields_ = (
        ("origin", ctypes.c_double * 3),
        ("inverse", ctypes.c_double),
        ("wall", LatticeStruct),
        ("remain", LatticeStruct),
    )


class Roadmap:
    """The way to a target, the walls and the wire as seen from the tip of a simulation's wire.

    The tip's frame is that of the wire's last link: z along the wire and out of its tip, the pre-shaped tip bends about
    x, towards -y. It turns with the wire and has no place where it jumps. Of two devices it is the frame of that whose
    tip is ahead, with its torsion: it changes where one tip passes the other.

    Args:
        target: one of its phantom's targets, or a point in the lumen.
        registration_noise: standard deviation, m an axis, of the displacement between scan and patient, which stays the
            same through an episode; 0: a perfect registration.
        scan: what is shown of the vessel; None: the vessel itself.
    """

    def __init__(
        self,
        simulation: Simulation,
        target: TargetLike,
        registration_noise: float = 0.0,
        scan: Scan | None = None,
    ) -> None:
        self.simulation, self.scan = simulation, scan
        self.registration_noise = quantity("registration_noise", registration_noise, _Noise)
        self.offset = np.zeros(3)
        self.aim(target)
        self._path = np.empty((round(PATH_ARCS[-1] / PATH_STEP), 3))
        self._shown = np.rint(PATH_ARCS / PATH_STEP).astype(int) - 1
        self._lengths = np.empty(len(RAYS))
        self._devices = simulation if isinstance(simulation, DualSimulation) else None
        self._far = simulation.max_insertion > FAR
        self.size = ROADMAP_SIZE + (_OF_PAIR if self._devices and self._devices.pair.both else 0)

    def __getstate__(self) -> dict[str, Any]:
        native = ("_struct", "_fields", "_follow", "_cast")  # made again where they are wanted
        return {name: value for name, value in self.__dict__.items() if name not in native}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _struct=None)

    def aim(self, target: TargetLike) -> None:
        """Changes the target."""
        self.target = as_target(target)
        self.goal = self.simulation.phantom.target(self.target).position  # m, world frame, (3,)
        self._struct: _RoadmapStruct | None = None

    def reset(self, generator: np.random.Generator) -> None:
        """Draws the episode's registration; without noise nothing is drawn."""
        if self.registration_noise:
            self.offset = generator.normal(0.0, self.registration_noise, 3)

    def _native(self) -> _RoadmapStruct:
        if self._struct is None:  # the geodesic field is only loaded when it is wanted
            phantom = self.simulation.phantom if self.scan is None else self.scan.phantom
            grid = phantom.grid
            self._fields = grid, phantom.geodesic_field(self.target)
            wall, remain = (LatticeStruct.of(field.blocks) for field in self._fields)
            self._struct = _RoadmapStruct(tuple(grid.origin.tolist()), 1.0 / grid.spacing, wall, remain)
            native = library()
            self._follow, self._cast = native.cathsim_roadmap_path, native.cathsim_roadmap_rays
            self._follow.restype, self._cast.restype = ctypes.c_double, None
        return self._struct

    def in_scan(self, place: np.ndarray) -> np.ndarray:
        """Where the scan shows a place (3,) m, world frame."""
        return (place if self.scan is None else self.scan.place(place)) + self.offset

    def frame(self) -> np.ndarray:
        """Axes of the tip's frame, as columns, world frame. Shape (3, 3)."""
        model, data = self.simulation.model, self.simulation.data
        axes = data.site_xmat[model.site(TIP_SITE).id].reshape(3, 3)
        if self._devices is None:
            return axes
        turn = self._devices.turn_of_leading()
        about_z = [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
        return np.asarray(axes @ about_z)

    def way(self, start: np.ndarray) -> tuple[np.ndarray, float]:
        """The way from a place (3,) m to the target: the next 50 mm of it, (50, 3) m, and its whole length, m."""
        start = np.ascontiguousarray(start, float)
        remaining = self._follow_from(start)
        return self._path.copy(), remaining

    def _follow_from(self, start: np.ndarray) -> float:
        struct = ctypes.byref(self._native())
        step, clearance = ctypes.c_double(PATH_STEP), ctypes.c_double(CLEARANCE)
        length = self._follow(struct, address(start), step, clearance, len(self._path), address(self._path))
        return float(length)

    def walls(self, start: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Distances (9,) m from a place (3,) m to the wall along RAYS, 30 mm at most.

        The columns of `axes` (3, 3) are the axes of the frame in which the rays are given.
        """
        start, directions = np.ascontiguousarray(start, float), RAYS @ axes.T
        struct, limit = ctypes.byref(self._native()), ctypes.c_double(RAY_LIMIT)
        self._cast(struct, address(start), limit, len(RAYS), address(directions), address(self._lengths))
        return self._lengths.copy()

    def read(self) -> np.ndarray:
        """The roadmap at the tip, all of the order of 1 and in the tip's frame.

        Points of the way 3, 6, 10, 16, 24, 36, 50 mm ahead, each over its distance along the way (21); the remaining
        way over 0.2 m, and the hyperbolic tangent of it over 20 mm (2); distances to the wall ahead, askew and across
        over 15 mm (9); points of the wire 4, 8, 12, 20, 30, 45, 60 mm behind the tip, each over its distance along the
        wire (21); insertion over 0.2 m, cosine and sine of the rotation (3); how far the feeder's drive is ahead of the
        wire, as a share of what its force limit allows, as felt by hand (2); velocity v of the tip over 20 mm/s + |v|
        (3); contact force f over 0.05 N + |f| (3). Insertion and rotation are the wire's; with two devices there
        follow those of the catheter (3), by how much l the wire's tip is ahead over 0.2 m, and the hyperbolic tangent
        of l over 20 mm (2), cosine and sine of the angle between the tips' cross-sections, wire less catheter (2).

        Devices of more than 0.6 m are shown at most 150 mm as the remaining way, and at most 280 mm less that as the
        wire's insertion, the catheter's less the lead, which is shown from -60 to 120 mm.

        Returns:
            Shape (64,), with two devices (71,), float32.
        """
        simulation = self.simulation
        points, axes = simulation.inserted_points(), self.frame()
        tip = points[0]
        start = self.in_scan(tip)
        seen_axes = axes if self.scan is None else self.scan.directions(axes)
        remaining, inserted = self._follow_from(start), simulation.insertion
        if self._far:
            remaining = min(remaining, AHEAD)
            inserted = min(inserted, ARCH - remaining)
        walls = self.walls(start, seen_axes)
        ahead = (self._path[self._shown] - start) @ seen_axes / PATH_ARCS[:, None]
        arc = np.concatenate(([0.0], np.cumsum(np.sqrt(np.square(np.diff(points, axis=0)).sum(axis=1)))))
        behind = np.stack([np.interp(WIRE_ARCS, arc, points[:, k]) for k in range(3)], axis=1)
        behind = (behind - tip) @ axes / WIRE_ARCS[:, None]
        force, velocity = simulation.force() @ axes, simulation.tip_velocity() @ axes
        rotation = simulation.rotation
        return np.concatenate(
            (
                ahead.ravel(),
                (remaining / REMAINING_SCALE, np.tanh(remaining / NEAR_SCALE)),
                walls / RAY_SCALE,
                behind.ravel(),
                (inserted / INSERTION_SCALE, np.cos(rotation), np.sin(rotation)),
                simulation.lead(),
                velocity / (SPEED_SCALE + np.sqrt(velocity @ velocity)),
                force / (FORCE_SCALE + np.sqrt(force @ force)),
                self._of_pair(inserted),
            )
        ).astype(np.float32)

    def _of_pair(self, wire_inserted: float) -> tuple[float, ...]:
        devices = self._devices
        if devices is None or not devices.pair.both:
            return ()
        lead, (inserted, turned) = devices.device_lead, devices.catheter_place()
        if self._far:
            lead = min(max(lead, LEADS[0]), LEADS[1])
            inserted = wire_inserted - lead
        wire, catheter = devices.tip_rotations()
        return (
            inserted / INSERTION_SCALE,
            math.cos(turned),
            math.sin(turned),
            lead / INSERTION_SCALE,
            math.tanh(lead / LEAD_SCALE),
            math.cos(wire - catheter),
            math.sin(wire - catheter),
        )


def target_image(pixel: np.ndarray, size: int, radius_px: float) -> np.ndarray:
    """An image (size, size) uint8 of the target's dot alone: 255 on the dot, with a soft edge, 0 elsewhere.

    Args:
        pixel: where the target is seen, px, column and row. Shape (2,).
        size: side of the image, px.
    """
    column, row = np.arange(size), np.arange(size)[:, None]
    distance = np.hypot(column - pixel[0], row - pixel[1])
    return np.rint(255 * np.clip(radius_px + 0.5 - distance, 0.0, 1.0)).astype(np.uint8)
