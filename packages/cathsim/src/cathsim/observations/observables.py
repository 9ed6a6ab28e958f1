"""Named observables of a simulation, each with its space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import gymnasium
import mujoco
import numpy as np

from cathsim.devices.active_chain import pass_on
from cathsim.devices.simulation import DEVICE_NAMES, DualSimulation
from cathsim.observations.fluoroscopes import FRAMES, BiplaneView, Fluoroscope, shown_device
from cathsim.observations.progress_history import History
from cathsim.observations.roadmap import Roadmap, target_image
from cathsim.observations.tracking import Tracking
from cathsim.simulation import Simulation

DEVICES_SHAPE = (2, 5)


DOT_SHARE, LEAST_DOT = 0.02, 1.5  # radius of the target's dot: a share of the image's side, or px
GUIDANCE = ("roadmap", "history", "tracking", "goal", "goal_image")  # those that know where the target is
OBSERVABLES = ("internal", "joints", "image", "mask", "sequential", "shape", "tip", "feeder", "force", *GUIDANCE)
DEVICES = "devices"  # one more with a catheter
MASKS = {"mask": None, **{f"mask_{device}": device for device in DEVICE_NAMES}}  # whose pixels; None: of both devices


def feeder_size(simulation: Simulation) -> int:
    """How many numbers `feeder` gives."""
    return 7 if isinstance(simulation, DualSimulation) and simulation.pair.both else 3


def feeder(simulation: Simulation) -> np.ndarray:
    """Insertion (m), cosine and sine of the rotation of the hub; of two devices, wire first, then the lead (m).

    Returns:
        Shape (3,), with two devices (7,), float32.
    """
    rotation = simulation.rotation
    wire = (simulation.insertion, np.cos(rotation), np.sin(rotation))
    if not (isinstance(simulation, DualSimulation) and simulation.pair.both):
        return np.array(wire, np.float32)
    inserted, turned = simulation.catheter_place()
    catheter = (inserted, np.cos(turned), np.sin(turned))
    return np.array((*wire, *catheter, simulation.device_lead), np.float32)


def devices(simulation: DualSimulation) -> np.ndarray:
    """Insertion (m), angles of hub and tip (rad), force of the feeder (N) and torque at the hub (N m) of each device.

    Returns:
        Shape (2, 5), float32, the wire's row first; zeros of an absent device.
    """
    rows = np.array(
        (
            simulation.device_insertions(),
            simulation.device_rotations(),
            simulation.tip_rotations(),
            simulation.feeder_forces(),
            simulation.hub_torques(),
        )
    ).T
    present = [simulation.pair.wire is not None, simulation.pair.catheter is not None]
    return np.where(np.array(present)[:, None], rows, 0.0).astype(np.float32)


def with_catheter(simulation: Simulation) -> DualSimulation:
    """The simulation as one with a catheter.

    Raises:
        ValueError: it is one of a bare wire.
    """
    if not isinstance(simulation, DualSimulation):
        raise ValueError("observation 'devices' needs a catheter: pass catheter='vertebral' or another")
    return simulation


@dataclass(frozen=True)
class Observable:
    """One entry of an observation."""

    space: gymnasium.spaces.Box
    read: Callable[[], np.ndarray]


def channels_behind(observable: Observable) -> Observable:
    """An image of shape (height, width, channels) instead of (channels, height, width); others as they are."""
    if observable.space.dtype != np.uint8:
        return observable
    channels, height, width = observable.space.shape
    space = gymnasium.spaces.Box(0, 255, (height, width, channels), np.uint8)
    return Observable(space, partial(_channels_behind, observable.read))


def _channels_behind(read: Callable[[], np.ndarray]) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(read(), 0, -1))


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


def _mask(fluoroscope: Fluoroscope, device: str | None) -> np.ndarray:
    return fluoroscope.mask(device)[None] * np.uint8(255)


_VECTORS = {"tip": _tip, "force": _force}


def make_observable(
    name: str,
    simulation: Simulation,
    fluoroscope: Fluoroscope,
    biplane: BiplaneView | None = None,
    roadmap: Roadmap | None = None,
    history: History | None = None,
    tracking: Tracking | None = None,
) -> Observable:
    """The observable of a name; "image_a", "mask_a" and so on are those of a bi-planar fluoroscope's cameras.

    "mask_wire" and "mask_catheter" ("mask_wire_a", ...) are the masks of each device; "mask" is that of both.

    Raises:
        ValueError: there is none.
    """
    if name in GUIDANCE:
        return _guidance(name, fluoroscope, roadmap, history, tracking)
    if name in MASKS:
        mask = partial(_mask, fluoroscope, shown_device(simulation, MASKS[name]))
        return Observable(gymnasium.spaces.Box(0, 255, (1, *fluoroscope.shape), np.uint8), mask)
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


def _guidance(
    name: str,
    fluoroscope: Fluoroscope,
    roadmap: Roadmap | None,
    history: History | None,
    tracking: Tracking | None,
) -> Observable:
    if roadmap is None or (name == "history" and history is None) or (name == "tracking" and tracking is None):
        raise ValueError(f"observation '{name}' needs a target: use it in a navigation environment")
    if history is not None and name == "history":
        return Observable(_box(history.size), history.read)
    if tracking is not None and name == "tracking":
        return Observable(_box(tracking.size), tracking.read)
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
    device: str | None = None
    first, _, rest = view.partition("_")
    if kind == "mask" and first in DEVICE_NAMES and rest:
        device, view = shown_device(biplane.simulation, first), rest
    if view not in cameras:
        known = ", ".join(f"image_{camera}, mask_{camera}" for camera in cameras)
        raise ValueError(f"unknown observation '{name}'; the cameras give {known}")
    projector = cameras[view].projector
    space = gymnasium.spaces.Box(0, 255, (1, projector.height, projector.width), np.uint8)
    if kind == "image":
        return Observable(space, partial(_view_image, biplane, view))
    return Observable(space, partial(_view_mask, biplane, view, device))


def _view_image(biplane: BiplaneView, view: str) -> np.ndarray:
    return biplane.frame(view).image[None].copy()


def _view_mask(biplane: BiplaneView, view: str, device: str | None) -> np.ndarray:
    return biplane.mask(view, device)[None] * np.uint8(255)
