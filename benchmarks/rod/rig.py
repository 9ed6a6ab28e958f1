"""Test rig for wires: models with the simulator's own options, dead loads, a feeder, coming to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from cathsim.arena import model_spec
from cathsim.contact.sdf import Vessel
from cathsim.guidewire import TIP_SITE, Guidewire, load_guidewire
from cathsim.presets import Accuracy

WORLD_SITE, FEEDER_STIFFNESS, FEEDER_DAMPING = "world", 2000.0, 40.0


@dataclass(frozen=True)
class Case:
    """One figure of the simulator beside theory's.

    Attributes:
        group: which law.
        name: its parameters.
        measured: by the simulator.
        theory: exact, in the same unit.
        remark: what else the table shows.
    """

    group: str
    name: str
    measured: float
    theory: float
    remark: str = ""

    @property
    def error_pct(self) -> float:
        """Signed relative error, %."""
        return 100 * (self.measured / self.theory - 1)


def new_spec(numerics: Accuracy) -> mujoco.MjSpec:
    """An empty model with exactly the options that the simulator's own models have.

    Args:
        numerics: time stepping.

    Returns:
        A specification with a site at the world's origin, the frame of dead loads.
    """
    box = Vessel(np.ones((3, 3, 3), np.float32), np.zeros(3), 1.0, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    reference = model_spec(box, load_guidewire("default"), numerics).option
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    for name in dir(reference):
        if not name.startswith("_"):
            setattr(spec.option, name, getattr(reference, name))
    spec.worldbody.add_site(name=WORLD_SITE)
    return spec


def uniform_wire(links: tuple[float, ...], stiffness_nmm2: float, **changes: object) -> Guidewire:
    """A straight wire of one bending stiffness.

    Args:
        links: lengths from the proximal end, m.
        stiffness_nmm2: bending stiffness EI, N mm^2.
        changes: other fields of `Guidewire`.

    Returns:
        The wire.
    """
    straight = {"tip_angle": 0.0, "tip_length": 0.0}
    uniform = {"shaft_stiffness_nmm2": stiffness_nmm2, "tip_stiffness_nmm2": stiffness_nmm2}
    return load_guidewire("default", links=links, **straight, **uniform, **changes)


def dead_load(spec: mujoco.MjSpec, name: str, direction: np.ndarray, site: str = TIP_SITE) -> mujoco.MjsActuator:
    """A force that keeps its direction in the world; its control is the force (N), its length the displacement (m).

    Args:
        spec: model under construction, from `new_spec`.
        name: of the actuator.
        direction: unit vector in the world. Shape (3,).
        site: where it acts.

    Returns:
        The actuator.
    """
    load = spec.add_actuator(name=name, target=site, refsite=WORLD_SITE, trntype=mujoco.mjtTrn.mjTRN_SITE)
    load.set_to_motor()
    load.gear = [*direction, 0.0, 0.0, 0.0]
    return load


def add_feeder(spec: mujoco.MjSpec, position: np.ndarray) -> mujoco.MjsBody:
    """A body that slides along the world's z, held by the position servo "feeder" as in the simulator's arena.

    Args:
        spec: model under construction.
        position: of the body, m. Shape (3,).

    Returns:
        The body, to which the wire is added.
    """
    body = spec.worldbody.add_body(name="feeder", pos=position)
    body.mass, body.inertia, body.explicitinertial = 1e-3, [1e-9] * 3, True
    body.add_joint(name="feeder", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], armature=0.02)
    servo = spec.add_actuator(name="feeder", target="feeder", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=FEEDER_STIFFNESS, kv=FEEDER_DAMPING)
    return body


def feeder_force(data: mujoco.MjData) -> float:
    """Force (N) of the feeder on the wire along +z, at the end of the last step.

    `actuator_force` is of the step's beginning, before the integrator's implicit treatment of the servo: while the
    feeder moves at speed v it is off by (servo stiffness) x v x timestep.
    """
    target, position, velocity = (
        data.actuator("feeder").ctrl[0],
        data.joint("feeder").qpos[0],
        data.joint("feeder").qvel[0],
    )
    return float(FEEDER_STIFFNESS * (target - position) - FEEDER_DAMPING * velocity)


def settle(model: mujoco.MjModel, data: mujoco.MjData, *, speed: float = 1e-6, limit: float = 120.0) -> float:
    """Steps until the wire rests.

    Args:
        model: of the wire.
        data: its state, advanced.
        speed: joint speed under which it counts as resting, rad/s.
        limit: simulated time after which it must, s.

    Returns:
        Simulated time that it took, s.

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

    Returns:
        The vessel.
    """
    axes = [a + spacing * np.arange(round((b - a) / spacing) + 1) for a, b in zip(low, high, strict=True)]
    values = np.broadcast_to(distance(*np.ix_(*axes)), [len(axis) for axis in axes])
    return Vessel(
        np.ascontiguousarray(values, np.float32),
        np.array(low),
        spacing,
        np.zeros(3),
        np.array([0.0, 0.0, 1.0]),
        sheath_radius=0.0,
    )
