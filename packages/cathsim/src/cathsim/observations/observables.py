"""Named observables of a simulation, each with its space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import gymnasium
import mujoco
import numpy as np
from annotated_types import Interval

from cathsim.anatomy import Phantom
from cathsim.contact.sdf import Vessel
from cathsim.fluoroscopy import BiplaneFluoroscope, FluoroscopyRenderer, Frame, Projector, background_image
from cathsim.fluoroscopy.biplane import MAXIMUM_SIZE
from cathsim.lifetime_cache import kept_with_owner
from cathsim.link_ladder import pass_on
from cathsim.observations.device_state import DEVICES_SHAPE, devices, feeder, feeder_size, with_catheter
from cathsim.observations.progress_history import History
from cathsim.observations.roadmap import Roadmap, target_image
from cathsim.simulation import Simulation
from cathsim.validation import Unit, quantity

_ImageSize = Annotated[int, Interval(ge=16, le=MAXIMUM_SIZE), Unit("px")]
FRAMES = 3  # of the sequential observation
SHOWN_SHEATH = 0.010  # this much of the wire inside the sheath is drawn, m
BEHIND = 0.12  # so much of the wire behind the entry is drawn in bi-planar images: to their border, m
BEHIND_STEP = 0.005
DOT_SHARE, LEAST_DOT = 0.02, 1.5  # radius of the target's dot: a share of the image's side, or px


@kept_with_owner
def camera(phantom: Phantom, size: int, wire_radius: float) -> FluoroscopyRenderer:
    """The frontal fluoroscope of a phantom, shared by every environment that looks at it."""
    projector = Projector.frontal(phantom.bounds, size)
    background = background_image(phantom.grid, projector, key=phantom.hash)
    centre = phantom.bounds.mean(axis=0)
    return FluoroscopyRenderer(projector, background, wire_radius=wire_radius, centre=centre)


class Fluoroscope:
    """Frontal image and mask of a simulation, drawn once a step at most."""

    def __init__(self, simulation: Simulation, size: int) -> None:
        size = quantity("image_size", size, _ImageSize)
        self.simulation = simulation
        self.renderer = camera(simulation.phantom, size, simulation.wire.radius)
        self.shape = (size, size)
        self._image, self._mask = np.empty(self.shape, np.uint8), np.empty(self.shape, np.uint8)
        self._drawn = self._kept = False
        self.frames: list[np.ndarray] = []

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "renderer"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.renderer = camera(self.simulation.phantom, self.shape[0], self.simulation.wire.radius)

    def update(self, *, restart: bool = False) -> None:
        """Says that the simulation has moved on (or restarted): the next look draws again."""
        self._drawn = self._kept = False
        if restart:
            self.frames = []

    def state(self) -> tuple[bool, list[np.ndarray]]:
        """The images kept for `sequence`, for `restore`."""
        return self._kept, list(self.frames)

    def restore(self, state: tuple[bool, list[np.ndarray]]) -> None:
        """Returns to kept images; the simulation has been restored before."""
        self._drawn = False
        self._kept, self.frames = state[0], list(state[1])

    def _draw(self) -> None:
        if not self._drawn:
            self.renderer.render_into(shown_points(self.simulation), self._image, self._mask)
            self._drawn = True

    def image(self) -> np.ndarray:
        """Grey image, wire dark. Shape (size, size), uint8, a copy."""
        self._draw()
        return self._image.copy()

    def mask(self) -> np.ndarray:
        """The wire's pixels, 0 or 1. Shape (size, size), uint8, a copy."""
        self._draw()
        return self._mask.copy()

    def sequence(self) -> np.ndarray:
        """The last three images, oldest first; the first image of an episode stands for the missing ones."""
        if not self._kept:  # a second look in the same step is no new frame
            latest = self.image()
            self.frames = [*self.frames[1:], latest] if self.frames else [latest] * FRAMES
            self._kept = True
        return np.stack(self.frames)


class BiplaneView:
    """Bi-planar images and masks of a simulation, each drawn once a step at most."""

    def __init__(self, simulation: Simulation, fluoroscope: BiplaneFluoroscope) -> None:
        self.simulation, self.fluoroscope = simulation, fluoroscope
        self._seed, self._moment = 0, 0
        self._frames: dict[str, Frame] = {}

    def update(self, *, seed: int | None = None) -> None:
        """Says that the simulation has moved on, or restarted with a seed of the episode's noise."""
        self._frames = {}
        self._moment += 1
        if seed is not None:
            self._seed, self._moment = seed, 0

    def state(self) -> tuple[int, int]:
        """Seed and moment of the noise, for `restore`."""
        return self._seed, self._moment

    def restore(self, state: tuple[int, int]) -> None:
        """Returns to a moment; the simulation has been restored before."""
        self._frames = {}
        self._seed, self._moment = state

    def frame(self, name: str) -> Frame:
        """Image and mask of a camera; not to be written into."""
        if name not in self._frames:
            # the noise of a moment depends on seed and step alone, not on which camera was looked at before
            generator = np.random.default_rng((self._seed, self._moment))
            points = points_to_border(self.simulation)
            self._frames[name] = self.fluoroscope.render(points, generator, only=(name,))[name]
        return self._frames[name]


def points_to_border(simulation: Simulation) -> np.ndarray:
    """Nodes of the wire from the tip through the sheath, on to where it has left every image, m. Shape (n, 3)."""
    points, vessel = simulation.inserted_points(), simulation.vessel
    behind = float((vessel.entry - points[-1]) @ vessel.direction)
    steps = np.arange(BEHIND_STEP, max(BEHIND - behind, 0.0) + BEHIND_STEP, BEHIND_STEP)
    return np.concatenate((points, points[-1] - steps[:, None] * vessel.direction))


def shown_points(simulation: Simulation) -> np.ndarray:
    """Nodes of the wire that a fluoroscope sees: from the tip to just inside the sheath, m. Shape (n, 3)."""
    return outside_sheath(simulation.inserted_points(), simulation.vessel)


def outside_sheath(points: np.ndarray, vessel: Vessel) -> np.ndarray:
    """Drops the nodes (k, 3) m, from the tip on, that lie deep inside the sheath, and closes the wire there."""
    end = vessel.entry - SHOWN_SHEATH * vessel.direction
    # the nodes in the sheath are the last ones
    shown = int(np.count_nonzero(points @ vessel.direction > end @ vessel.direction))
    return np.concatenate((points[:shown], end[None]))


@dataclass(frozen=True)
class Observable:
    """One entry of an observation."""

    space: gymnasium.spaces.Box
    read: Callable[[], np.ndarray]


def _box(size: int) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)


def joints(simulation: Simulation) -> np.ndarray:
    """Joint positions, then velocities (m, rad, m/s, rad/s). Shape (2 nq,)."""
    return np.concatenate((simulation.joint_positions(), simulation.joint_velocities())).astype(np.float32)


def internal(simulation: Simulation) -> np.ndarray:
    """The thesis's internal observation: positions, velocities, inertias, and actuator and external forces.

    Joint positions (nq), joint velocities (nq), centre-of-mass inertia (10 a body), centre-of-mass velocity (6 a body),
    actuator forces (nq), external forces (6 a body); bodies are the feeder and links 1 to N - 1; links that are not yet
    simulated give zeros. Shape (3 nq + 22 bodies,).
    """
    model, data, nq = simulation.model, simulation.data, simulation.nq
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    bodies = len(simulation.wire.links)
    per_body = np.zeros((bodies, 22), np.float32)
    # row 0 is the feeder; the simulated links are the most distal ones
    rows = np.r_[0, bodies - model.nbody + 2 : bodies]
    per_body[rows, :10] = data.cinert[1:]
    per_body[rows, 10:16] = data.cvel[1:]
    per_body[rows, 16:] = data.cfrc_ext[1:]
    actuator = pass_on(data.qfrc_actuator, nq, bend=False)
    return np.concatenate((joints(simulation), actuator.astype(np.float32), per_body.ravel()))


def _shape(simulation: Simulation) -> np.ndarray:
    return simulation.wire_points().astype(np.float32)


def _tip(simulation: Simulation) -> np.ndarray:
    return simulation.tip.astype(np.float32)


def _force(simulation: Simulation) -> np.ndarray:
    return simulation.force().astype(np.float32)


def _image(fluoroscope: Fluoroscope) -> np.ndarray:
    return fluoroscope.image()[None]


def _mask(fluoroscope: Fluoroscope) -> np.ndarray:
    return fluoroscope.mask()[None] * np.uint8(255)


_VECTORS = {"tip": _tip, "force": _force}
GUIDANCE = ("roadmap", "history", "goal", "goal_image")  # those that know where the target is
OBSERVABLES = ("internal", "joints", "image", "mask", "sequential", "shape", "tip", "feeder", "force", *GUIDANCE)
DEVICES = "devices"  # one more with a catheter


def make_observable(
    name: str,
    simulation: Simulation,
    fluoroscope: Fluoroscope,
    biplane: BiplaneView | None = None,
    roadmap: Roadmap | None = None,
    history: History | None = None,
) -> Observable:
    """The observable of a name; "image_a", "mask_a" and so on are those of a bi-planar fluoroscope's cameras.

    Raises:
        ValueError: there is none.
    """
    if name in GUIDANCE:
        return _guidance(name, fluoroscope, roadmap, history)
    kind, _, view = name.partition("_")
    if kind in ("image", "mask") and view:
        return _camera_observable(name, kind, view, biplane)
    box, nodes = gymnasium.spaces.Box, len(simulation.wire.links) + 1
    if name == "internal":
        size = 3 * simulation.nq + 22 * len(simulation.wire.links)
        return Observable(_box(size), partial(internal, simulation))
    if name == "joints":
        return Observable(_box(2 * simulation.nq), partial(joints, simulation))
    if name == "image":
        return Observable(box(0, 255, (1, *fluoroscope.shape), np.uint8), partial(_image, fluoroscope))
    if name == "mask":
        return Observable(box(0, 255, (1, *fluoroscope.shape), np.uint8), partial(_mask, fluoroscope))
    if name == "sequential":
        return Observable(box(0, 255, (FRAMES, *fluoroscope.shape), np.uint8), fluoroscope.sequence)
    if name == "shape":
        return Observable(box(-np.inf, np.inf, (nodes, 3), np.float32), partial(_shape, simulation))
    if name in _VECTORS:
        return Observable(_box(3), partial(_VECTORS[name], simulation))
    if name == "feeder":
        return Observable(_box(feeder_size(simulation)), partial(feeder, simulation))
    if name == DEVICES:
        return Observable(box(-np.inf, np.inf, DEVICES_SHAPE, np.float32), partial(devices, with_catheter(simulation)))
    raise ValueError(f"unknown observation '{name}'; there are {', '.join((*OBSERVABLES, DEVICES))}")


def _guidance(name: str, fluoroscope: Fluoroscope, roadmap: Roadmap | None, history: History | None) -> Observable:
    if roadmap is None or (name == "history" and history is None):
        raise ValueError(f"observation '{name}' needs a target: use it in a navigation environment")
    if history is not None and name == "history":
        return Observable(_box(history.size), history.read)
    if name == "roadmap":
        return Observable(_box(roadmap.size), roadmap.read)
    if name == "goal":
        return Observable(_box(3), partial(_goal, roadmap))
    return Observable(gymnasium.spaces.Box(0, 255, (1, *fluoroscope.shape), np.uint8), _GoalDot(roadmap, fluoroscope))


def _goal(roadmap: Roadmap) -> np.ndarray:
    return roadmap.goal.astype(np.float32)


class _GoalDot:
    """The target's dot in the frontal view, drawn once a target. Shape (1, size, size), uint8."""

    def __init__(self, roadmap: Roadmap, fluoroscope: Fluoroscope) -> None:
        self._roadmap, self._fluoroscope = roadmap, fluoroscope
        self._goal: np.ndarray | None = None

    def __call__(self) -> np.ndarray:
        goal, size = self._roadmap.goal, self._fluoroscope.shape[0]
        if self._goal is not goal:
            pixel = self._fluoroscope.renderer.projector.project(goal[None])[0]
            self._dot = target_image(pixel, size, max(DOT_SHARE * size, LEAST_DOT))[None]
            self._goal = goal
        return self._dot.copy()


def _camera_observable(name: str, kind: str, view: str, biplane: BiplaneView | None) -> Observable:
    if biplane is None:
        raise ValueError(f"observation '{name}' needs a bi-planar fluoroscope: pass cameras='guide3d' or 'clinical'")
    cameras = biplane.fluoroscope.cameras
    if view not in cameras:
        known = ", ".join(f"image_{camera}, mask_{camera}" for camera in cameras)
        raise ValueError(f"unknown observation '{name}'; the cameras give {known}")
    projector = cameras[view].projector
    space = gymnasium.spaces.Box(0, 255, (1, projector.height, projector.width), np.uint8)
    if kind == "image":
        return Observable(space, partial(_view_image, biplane, view))
    return Observable(space, partial(_view_mask, biplane, view))


def _view_image(biplane: BiplaneView, view: str) -> np.ndarray:
    return biplane.frame(view).image[None].copy()


def _view_mask(biplane: BiplaneView, view: str) -> np.ndarray:
    return biplane.frame(view).mask[None] * np.uint8(255)
