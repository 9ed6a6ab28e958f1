"""The MuJoCo model of a wire, its feeder and a vessel."""

from __future__ import annotations

import mujoco
import numpy as np

from cathsim.contact.breathing import MOTION
from cathsim.contact.sdf import Vessel
from cathsim.guidewire import Guidewire
from cathsim.presets import Accuracy

FEEDER, ADVANCE, ROTATE = "feeder", "advance", "rotate"
PROTRUSION = 0.005  # the tip lies this far inside the vessel at zero insertion, m
FEEDER_STIFFNESS, FEEDER_DAMPING = 2000.0, 40.0  # of the servo that advances, N/m and N s/m
RESERVE = 0.028  # at least this much simulated wire lies in the sheath, m


def empty_spec(numerics: Accuracy) -> mujoco.MjSpec:
    """A specification without bodies, with the solver's options that every model of a wire has."""
    spec = mujoco.MjSpec()
    spec.modelname = "cathsim"
    spec.compiler.degree = False
    option = spec.option
    option.timestep = numerics.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.tolerance = 1e-6  # a hundredth of what changes forces visibly
    option.gravity = [0.0, 0.0, 0.0]  # the wire's weight is below a hundredth of its contact forces
    # an invalid state is reported, never silently reset
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)  # one wire is one island
    return spec


def model_spec(
    vessel: Vessel, wire: Guidewire, numerics: Accuracy, *, tip_motors: bool = False, breathes: bool = False
) -> mujoco.MjSpec:
    """Describes a wire whose proximal end a feeder advances and rotates along the sheath's axis.

    Args:
        tip_motors: adds a motor to each of the two hinges of the most distal joints.
        breathes: the model has memory for the vessel's motion.

    Returns:
        The specification; controls are the feeder's advance (m), its rotation (rad), then motor torques (N m).
    """
    spec = empty_spec(numerics)
    vessel.add_to(spec)
    if breathes:
        spec.nuserdata = MOTION  # which the native step sets

    quaternion = np.zeros(4)
    mujoco.mju_quatZ2Vec(quaternion, vessel.direction)
    base = vessel.entry - vessel.direction * (wire.length - PROTRUSION)
    feeder = spec.worldbody.add_body(name=FEEDER, pos=base, quat=quaternion)
    axis = [0, 0, 1]
    feeder.add_joint(name=ADVANCE, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, armature=0.02)
    feeder.add_joint(name=ROTATE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, armature=2e-5)
    wire.add_to(feeder, mass_scale=numerics.mass_scale)

    _add_servo(spec, ADVANCE, stiffness=FEEDER_STIFFNESS, damping=FEEDER_DAMPING, limit=8.0)
    _add_servo(spec, ROTATE, stiffness=0.05, damping=0.002, limit=0.02)
    if tip_motors:
        for joint in spec.joints[-2 * min(wire.motor_joints, wire.joints) :]:
            limit = float(np.asarray(joint.stiffness).flat[0]) * wire.motor_angle
            motor = spec.add_actuator(name=f"{joint.name}_motor", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]
    return spec


def compiled_model(
    vessel: Vessel, wire: Guidewire, numerics: Accuracy, *, tip_motors: bool = False, breathes: bool = False
) -> mujoco.MjModel:
    """The model that a simulation steps; arguments as of `model_spec`."""
    model = model_spec(vessel, wire, numerics, tip_motors=tip_motors, breathes=breathes).compile()
    if not vessel.wall_parts(model):  # a tree of boxes saves nothing where one geom is the wall
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    if breathes:
        model.flg_surfacevel = True  # the velocity of the walls, which the native step gives to the contacts
    return model


def _add_servo(spec: mujoco.MjSpec, joint: str, *, stiffness: float, damping: float, limit: float) -> None:
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=stiffness, kv=damping)
    servo.forcelimited, servo.forcerange = True, [-limit, limit]


def max_insertion(wire: Guidewire) -> float:
    """How far the feeder can advance, m."""
    return wire.length - PROTRUSION - RESERVE
