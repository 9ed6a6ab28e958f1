"""The follower robot's mechanics: a rail, four platforms, two clamps and two rotary parts, with servos on all joints.

Frame: origin where the wire leaves the robot towards the sheath, +z along the wire to the patient, +y to the rail.
After the CathBot follower as the thesis describes it; measures and servo strengths are assumed.
"""

from __future__ import annotations

from typing import Annotated

import mujoco
import numpy as np
from annotated_types import Interval

from cathsim.validation import Unit, settings

HOLDING_CLAMP, CATHETER_ROTARY, GUIDEWIRE_ROTARY, DRIVING_CLAMP = PLATFORMS = (
    "holding_clamp",
    "catheter_rotary",
    "guidewire_rotary",
    "driving_clamp",
)
CLAMPS, ROTARIES = (HOLDING_CLAMP, DRIVING_CLAMP), (CATHETER_ROTARY, GUIDEWIRE_ROTARY)
CARRIAGE = (GUIDEWIRE_ROTARY, DRIVING_CLAMP)  # platforms that move along the rail together
JAWS, WHEEL = ("{}_jaw_left", "{}_jaw_right"), "{}_wheel"

# Distances from the patient backwards, m: to the first platform, between neighbours, and of rail behind the last.
FIRST, PITCH, REAR = 0.030, 0.042, 0.025
RAIL_HEIGHT = 0.036  # of the wire above the rail, m

_Travel = Annotated[float, Interval(gt=0, le=1), Unit("m")]
_Speed = Annotated[float, Interval(gt=0, le=10), Unit("m/s")]

STEEL, BLUE, GREY, JAW, WHEEL_COLOUR, MARK = (
    [0.70, 0.72, 0.75, 1.0],
    [0.24, 0.36, 0.56, 1.0],
    [0.45, 0.47, 0.50, 1.0],
    [0.93, 0.62, 0.17, 1.0],
    [0.86, 0.87, 0.90, 1.0],
    [0.80, 0.15, 0.15, 1.0],
)


@settings
class RobotSettings:
    """Measures and limits of the follower robot."""

    stroke: _Travel = 0.040  # travel of the driving clamp along the rail, m
    jaw_opening: _Travel = 0.005  # travel of a jaw, m
    speed: _Speed = 0.030  # limit of the carriage while it drives the wire, m/s
    return_speed: _Speed = 0.080  # ... while it returns with its clamp open, m/s.
    rotation_speed: Annotated[float, Interval(gt=0, le=1000), Unit("rad/s")] = 4.0  # limit of the wheels, rad/s
    jaw_speed: _Speed = 0.050  # limit of the jaws, m/s
    # a commanded translation that is still to be done is remembered up to this, m; what goes beyond is lost
    backlog: _Travel = 0.004
    rotation_backlog: Annotated[float, Interval(gt=0, le=1000), Unit("rad")] = 0.4  # the same of the rotation, rad
    timestep: Annotated[float, Interval(ge=1e-6, le=0.1), Unit("s")] = 0.005  # of the robot's own simulation, s

    def home(self, platform: str) -> float:
        """Place of a platform on the rail at joint position 0, m behind the robot's front."""
        index = PLATFORMS.index(platform)
        return FIRST + index * PITCH + (self.stroke if platform in CARRIAGE else 0.0)

    @property
    def length(self) -> float:
        """Of the rail, m."""
        return self.home(DRIVING_CLAMP) + REAR


def robot_spec(settings: RobotSettings) -> mujoco.MjSpec:
    """Describes the robot: a slide for each platform and jaw, a hinge for each wheel, a position servo for every joint.

    Platforms: 0 is the rear end of their travel, m, positive towards the patient. Jaws: 0 is closed, m. Wheels: rad,
    positive about +z.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "follower_robot"
    spec.compiler.degree = False
    spec.option.timestep = settings.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = [0.0, 0.0, 0.0]  # the rail carries the platforms
    middle = -settings.length / 2
    for side in (-1, 1):
        _part(spec.worldbody, [0.004, 0.003, settings.length / 2], [side * 0.012, RAIL_HEIGHT, middle], STEEL)
    _part(spec.worldbody, [0.020, 0.002, settings.length / 2], [0, RAIL_HEIGHT + 0.005, middle], GREY)
    for platform in PLATFORMS:
        travel = settings.stroke if platform in CARRIAGE else PITCH / 4
        body = spec.worldbody.add_body(name=platform, pos=[0, 0, -settings.home(platform)])
        _joint(spec, body, platform, mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], (0.0, travel), mass=0.3)
        _part(body, [0.018, 0.003, 0.014], [0, RAIL_HEIGHT - 0.006, 0], BLUE)
        if platform in CLAMPS:
            _add_clamp(spec, body, platform, settings)
        else:
            _add_rotary(spec, body, platform)
    return spec


def _add_clamp(spec: mujoco.MjSpec, platform: mujoco.MjsBody, name: str, settings: RobotSettings) -> None:
    _part(platform, [0.016, 0.003, 0.006], [0, 0.012, 0], GREY)
    for side in (-1, 1):
        _part(platform, [0.002, 0.009, 0.006], [side * 0.012, 0.021, 0], GREY)
    for joint, side in zip(JAWS, (1, -1), strict=True):
        jaw = platform.add_body(name=joint.format(name))
        travel = (0.0, settings.jaw_opening)
        _joint(spec, jaw, joint.format(name), mujoco.mjtJoint.mjJNT_SLIDE, [side, 0, 0], travel, mass=0.02)
        _part(jaw, [0.004, 0.006, 0.010], [side * 0.0045, 0, 0], JAW)


def _add_rotary(spec: mujoco.MjSpec, platform: mujoco.MjsBody, name: str) -> None:
    for side in (-1, 1):
        _part(platform, [0.002, 0.012, 0.010], [side * 0.016, 0.016, 0], GREY)
    wheel = platform.add_body(name=WHEEL.format(name))
    _joint(spec, wheel, WHEEL.format(name), mujoco.mjtJoint.mjJNT_HINGE, [0, 0, 1], None, mass=0.05)
    _part(wheel, [0.0135, 0.006, 0], [0, 0, 0], WHEEL_COLOUR, mujoco.mjtGeom.mjGEOM_CYLINDER)
    _part(wheel, [0.0016, 0.0050, 0.0066], [0, -0.0084, 0], MARK)


def _joint(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtJoint,
    axis: list[float],
    travel: tuple[float, float] | None,
    *,
    mass: float,
) -> None:
    """A joint, its body's mass, and its servo: stiff enough to settle in 50 ms, damped critically."""
    inertia = mass * 0.009**2
    body.mass, body.inertia, body.explicitinertial = mass, [inertia] * 3, True
    joint = body.add_joint(name=name, type=kind, axis=axis)
    if travel is not None:
        joint.limited, joint.range = True, list(travel)
    moved = inertia if kind == mujoco.mjtJoint.mjJNT_HINGE else mass
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    stiffness = moved * 80.0**2
    servo.set_to_position(kp=stiffness, kv=2 * moved * 80.0)
    if travel is not None:
        servo.ctrllimited, servo.ctrlrange = True, list(travel)


def _part(
    body: mujoco.MjsBody,
    size: list[float],
    place: list[float],
    colour: list[float],
    kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_BOX,
) -> None:
    # the wire is held by assumption, so nothing of the robot collides
    body.add_geom(type=kind, size=size, pos=np.array(place), rgba=colour, contype=0, conaffinity=0, mass=0.0)
