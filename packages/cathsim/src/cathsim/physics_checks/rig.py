"""The rig of the physics checks: models with the simulator's options, dead loads, a feeder, stepping until rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import FEEDER, FEEDER_DAMPING, FEEDER_STIFFNESS, empty_spec
from cathsim.guidewire import TIP_SITE, Guidewire, load_guidewire
from cathsim.presets import Accuracy

WORLD_SITE = "world"


@dataclass(frozen=True)
class TheoryCheck:
    """A measured value beside the value of theory, in the same unit."""

    law: str  # one of `LAWS`
    name: str  # parameters of the case
    measured: float  # by the simulator
    theory: float  # exact
    remark: str = ""  # further figures, for a reader

    @property
    def error_pct(self) -> float:
        """Signed relative error, %."""
        return 100 * (self.measured / self.theory - 1)


def new_spec(numerics: Accuracy) -> mujoco.MjSpec:
    """An empty model with the simulator's options and a site at the world's origin, the frame of dead loads."""
    spec = empty_spec(numerics)
    spec.worldbody.add_site(name=WORLD_SITE)
    return spec


def uniform_wire(links: tuple[float, ...], stiffness_nmm2: float, **changes: object) -> Guidewire:
    """A straight wire of one bending stiffness.

    Args:
        links: lengths from the proximal end, m.
        stiffness_nmm2: bending stiffness EI, N mm^2.
        changes: other fields of `Guidewire`.
    """
    straight = {"tip_angle": 0.0, "tip_length": 0.0}
    uniform = {"shaft_stiffness_nmm2": stiffness_nmm2, "tip_stiffness_nmm2": stiffness_nmm2}
    return load_guidewire("default", links=links, **straight, **uniform, **changes)


def dead_load(spec: mujoco.MjSpec, name: str, direction: np.ndarray, site: str = TIP_SITE) -> None:
    """Adds a force that keeps its direction in the world.

    Args:
        spec: model under construction, from `new_spec`.
        name: of the actuator; its control is the force (N), its length the displacement (m).
        direction: unit vector in the world. Shape (3,).
    """
    load = spec.add_actuator(name=name, target=site, refsite=WORLD_SITE, trntype=mujoco.mjtTrn.mjTRN_SITE)
    load.set_to_motor()
    load.gear = [*direction, 0.0, 0.0, 0.0]


def add_feeder(spec: mujoco.MjSpec, position: np.ndarray) -> mujoco.MjsBody:
    """Adds a body that slides along the world's z and holds the wire; its servo is the arena's.

    Args:
        position: of the body, m. Shape (3,).
    """
    body = spec.worldbody.add_body(name=FEEDER, pos=position)
    body.mass, body.inertia, body.explicitinertial = 1e-3, [1e-9] * 3, True
    body.add_joint(name=FEEDER, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], armature=0.02)
    servo = spec.add_actuator(name=FEEDER, target=FEEDER, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=FEEDER_STIFFNESS, kv=FEEDER_DAMPING)
    return body


def feeder_force(data: mujoco.MjData) -> float:
    """Force (N) of the feeder on the wire along +z, at the end of the last step.

    `actuator_force` is of the step's beginning, before the integrator's implicit treatment of the servo: while the
    feeder moves at speed v it is off by (servo stiffness) x v x timestep.
    """
    joint = data.joint(FEEDER)
    stretch = data.actuator(FEEDER).ctrl[0] - joint.qpos[0]
    return float(FEEDER_STIFFNESS * stretch - FEEDER_DAMPING * joint.qvel[0])


def settle(model: mujoco.MjModel, data: mujoco.MjData, *, speed: float = 1e-6, limit: float = 120.0) -> float:
    """Steps until the wire rests; returns the simulated time that it took, s.

    Args:
        speed: the wire rests below this joint speed, rad/s.
        limit: longest simulated time, s.

    Raises:
        RuntimeError: it did not come to rest.
    """
    begin, quiet = data.time, 0
    while quiet < 20:
        mujoco.mj_step(model, data)
        fastest = float(np.abs(data.qvel).max())
        quiet = quiet + 1 if fastest < speed else 0
        if not data.time - begin < limit or not np.isfinite(fastest):
            raise RuntimeError(
                f"the wire does not rest after {limit} s: its fastest joint moves at {fastest:.1e} rad/s"
            )
    mujoco.mj_forward(model, data)
    return float(data.time - begin)


def sampled_vessel(
    distance: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    spacing: float,
) -> Vessel:
    """A vessel without a sheath, sampled from a signed distance.

    Args:
        distance: of x, y, z (m, broadcastable), positive in free space, m.
        low: a corner of the grid, m.
        high: the opposite corner, m.
        spacing: between nodes, m.
    """
    axes = [a + spacing * np.arange(round((b - a) / spacing) + 1) for a, b in zip(low, high, strict=True)]
    values = np.broadcast_to(distance(*np.ix_(*axes)), [len(axis) for axis in axes])
    grid = SignedDistanceGrid(values, low, spacing)
    return Vessel(grid, np.zeros(3), np.array([0.0, 0.0, 1.0]), sheath_radius=0.0)
