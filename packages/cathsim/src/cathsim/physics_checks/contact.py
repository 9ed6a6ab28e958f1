"""Contact of the wire: drawn round a post (capstan), buckled into a helix in a straight tube."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np

from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import FEEDER
from cathsim.guidewire import LINK_NAME
from cathsim.physics_checks.rig import (
    TheoryCheck,
    add_feeder,
    dead_load,
    feeder_force,
    new_spec,
    sampled_vessel,
    settle,
    uniform_wire,
)
from cathsim.presets import ACCURACY

POST_RADIUS = 0.020
PULL = 0.1  # tension of the slack side, N
HELIX_EI = 15.0e-6  # bending stiffness of the default wire's tip, N m^2


def post(radius: float, spacing: float = 0.001) -> Vessel:
    """The space outside a cylinder about the x axis, `radius` in m."""
    half = radius + 0.008
    low, high = (-2 * spacing, -half, -half), (2 * spacing, half, half)
    return sampled_vessel(lambda x, y, z: np.hypot(y, z) - radius + 0 * x, low, high, spacing)


def tube(radius: float, length: float, spacing: float) -> Vessel:
    """The inside of a cylinder about the z axis, `radius` and `length` in m."""
    half = spacing * math.ceil(radius / spacing + 3)
    low, high = (-half, -half, -half), (half, half, spacing * math.ceil(length / spacing))
    return sampled_vessel(lambda x, y, z: radius - np.hypot(x, y) + 0 * z, low, high, spacing)


def tension_ratio(friction: float, angle: float, *, speed: float = 0.005, link: float = 0.0025) -> tuple[float, float]:
    """Measures the ratio of tensions of a limp wire that is drawn slowly over a post against a dead load.

    Uses the `reference` preset. The drawn side lies along z, the direction of the dead load fixes the angle of wrap.
    The mean is over the travel of two links, so that every phase of a link on the post has the same weight.

    Args:
        angle: of wrap, rad.
        speed: of the feeder, m/s.
        link: length of the links, m.

    Returns:
        The ratio, and its standard deviation in time.
    """
    numerics = ACCURACY["reference"]
    free = 0.030
    reach = POST_RADIUS + uniform_wire((link,) * 2, 1.0).radius
    count = round((2 * free + reach * angle) / link)
    wire = uniform_wire((link,) * count, 0.01, friction=friction)
    spec = new_spec(numerics)
    vessel = post(POST_RADIUS)
    vessel.add_to(spec)
    wire.add_to(add_feeder(spec, np.array([0, -reach, -free])), mass_scale=numerics.mass_scale)
    dead_load(spec, "load", np.array([0.0, math.sin(angle), math.cos(angle)]))
    model = spec.compile()
    data = mujoco.MjData(model)
    # begins wrapped: turns of a link's angle about -x where the post is
    left = angle
    for index in range(math.ceil(free / link), count):
        turn = min(link / reach, left)
        data.joint(LINK_NAME.format(index) + "x").qpos = -turn
        left -= turn
    data.actuator("load").ctrl = PULL
    ease, travel = 0.5, 2 * link
    steps, ratios = round((ease + 0.5 + travel / speed) / numerics.timestep), []
    for i in range(steps):
        data.actuator(FEEDER).ctrl = -speed * max(0.0, i * numerics.timestep - ease)
        mujoco.mj_step(model, data)
        if i * numerics.timestep >= ease + 0.5:
            ratios.append(-feeder_force(data) / PULL)
    return float(np.mean(ratios)), float(np.std(ratios))


def capstan_cases(quick: bool) -> list[TheoryCheck]:
    """Tension ratios against e^(friction x angle).

    Friction acts on the surface of the wire, tension along its axis: the exponent of a wire of radius r on a post of
    radius R is smaller by R / (R + r). The remark gives the error against that.

    Args:
        quick: half of the eight cases, at one speed.
    """
    chosen = [(0.06, 1.0, 5), (0.1, 0.5, 5), (0.2, 1.0, 5), (0.3, 0.5, 5)]
    if not quick:
        chosen = [(friction, turns, 5) for friction in (0.06, 0.1, 0.2, 0.3) for turns in (0.5, 1.0)]
        # friction that creeps would depend on the speed
        chosen += [(0.2, 1.0, 2), (0.2, 1.0, 10), (0.2, 1.0, 20)]
    thick = POST_RADIUS / (POST_RADIUS + uniform_wire((0.01,) * 2, 1.0).radius)
    cases = []
    for friction, turns, speed in chosen:
        angle = turns * math.pi
        ratio, deviation = tension_ratio(friction, angle, speed=1e-3 * speed)
        corrected = 100 * (ratio / math.exp(friction * angle * thick) - 1)
        remark = f"± {deviation / ratio:.2%} in time; {corrected:+.2f} % from the thick wire's"
        cases.append(
            TheoryCheck(
                "capstan", f"μ {friction:g}, θ {turns:g} π, {speed} mm/s", ratio, math.exp(friction * angle), remark
            )
        )
    return cases


@dataclasses.dataclass(frozen=True)
class Helix:
    """Measurements of a wire that is buckled in a tube."""

    force: float  # axial, at the proximal end, N
    pitch: float  # m
    line_load: float  # force on the wall per axial length, N/m
    rest: float  # simulated time to rest, s


def buckled_helix(clearance: float, load: float) -> Helix:
    """Loads a wire in a frictionless tube until it lies on the wall as a helix, and measures the helix.

    The feeder clamps the wire on the axis of the tube. The free end carries a dead load along the axis and may turn, so
    no torque acts. At first each joint bends by 1 mrad, in a direction that turns once over the whole length: this
    chooses the hand of the helix, not its pitch. Steps of 2 ms with the mass of the `accurate` preset. Pitch and wall
    force are measured in the middle two fifths, the axial force at the feeder.

    Args:
        clearance: radius of the tube less that of the wire, m.
        load: at the free end, N.
    """
    numerics = dataclasses.replace(ACCURACY["accurate"], timestep=0.002)
    wire = uniform_wire((0.004,) * 60, HELIX_EI * 1e6, friction=0.0, relaxation=0.02)
    spec = new_spec(numerics)
    vessel = tube(clearance + wire.radius, wire.length + 0.01, 0.0005)
    vessel.add_to(spec)
    wire.add_to(add_feeder(spec, np.zeros(3)), mass_scale=numerics.mass_scale, clamped=True)
    dead_load(spec, "load", np.array([0.0, 0.0, -1.0]))
    model = spec.compile()
    data = mujoco.MjData(model)
    turn = 2 * math.pi * np.arange(len(wire.links)) / len(wire.links)
    data.qpos[1:] = 1e-3 * np.column_stack((np.cos(turn), np.sin(turn))).ravel()
    ramp = round(1.0 / numerics.timestep)
    for i in range(ramp):
        data.actuator("load").ctrl = load * (i + 1) / ramp
        mujoco.mj_step(model, data)
    rest = 1.0 + settle(model, data, speed=1e-2, limit=20.0)

    nodes = np.array([data.body(LINK_NAME.format(i)).xpos for i in range(1, len(wire.links))])
    low, high = 0.3 * nodes[-1, 2], 0.7 * nodes[-1, 2]
    middle = nodes[(nodes[:, 2] > low) & (nodes[:, 2] < high)]
    angle = np.unwrap(np.arctan2(middle[:, 1], middle[:, 0]))
    pitch = 2 * math.pi / abs(np.polyfit(middle[:, 2], angle, 1)[0])

    heights, forces, wrench = [], [], np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        heights.append(data.contact.pos[i, 2])
        forces.append(wrench[0])
    order = np.argsort(heights)
    height, force = np.array(heights)[order], np.array(forces)[order]
    total = np.cumsum(force) - force / 2
    inside = (height > low) & (height < high)
    line_load = float(np.polyfit(height[inside], total[inside], 1)[0])
    return Helix(feeder_force(data), pitch, line_load, rest)


def helix_cases(quick: bool) -> list[TheoryCheck]:
    """Axial force against 8 pi^2 EI / p^2 and wall force per length against r F^2 / (4 EI), with p and F measured.

    Both laws are for helices of small slope; at finite slope b the force is smaller by cos^3 b, which the remark gives.

    Returns:
        Forces in N, line loads in N/m.
    """
    chosen = [(0.001, 0.3), (0.001, 0.4)] if quick else [(0.001, 0.3), (0.001, 0.4), (0.001, 0.5), (0.0015, 0.3)]
    cases = []
    for clearance, load in chosen:
        helix = buckled_helix(clearance, load)
        name = f"r {1e3 * clearance:g} mm, {load:g} N"
        law = 8 * math.pi**2 * HELIX_EI / helix.pitch**2
        finite = law * math.cos(math.atan(2 * math.pi * clearance / helix.pitch)) ** 3
        remark = f"pitch {1e3 * helix.pitch:.1f} mm; {100 * (helix.force / finite - 1):+.2f} % at finite slope"
        cases.append(TheoryCheck("helix", f"{name}: F", helix.force, law, remark))
        wall = clearance * helix.force**2 / (4 * HELIX_EI)
        cases.append(TheoryCheck("helix", f"{name}: wall", helix.line_load, wall, f"at rest after {helix.rest:.1f} s"))
    return cases
