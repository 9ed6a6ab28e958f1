"""The composite rod of two devices against theory: cantilevers, two rods held coaxial, twist in a bent sheath."""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.rod import CATHETER, DEVICES, Rod, device_tables
from cathsim.guidewire import load_guidewire
from cathsim.physics_checks.rig import TheoryCheck, dead_load, new_spec, settle
from cathsim.physics_checks.statics import rod_deflection
from cathsim.presets import ACCURACY, Accuracy

Array = NDArray[np.float64]

# leads of wire before catheter, m: the last one leaves the wire's end out of the catheter
COVERAGES = (0.0, 0.005, 0.013, 0.027, 0.05, 0.085, 0.13, 0.2, -0.031, -0.11)
CLAMPED = 0.25  # length of the clamped chain, m
LOAD = 0.01  # dead load of the cantilevers, N
COAXIAL_STEP = 0.5e-3  # of two coaxial rods' common centreline, m
COAXIAL_LEADS = (0.0, 0.005, 0.013, 0.017, 0.027, 0.040, 0.060, 0.085)  # m
SHEATH_BEND, SHEATH_ARC = 40.0, 0.060  # curvature of a bent sheath, 1/m, and length of the bend, m


class ClampedPair:
    """The chain of two devices, clamped where it begins, with a dead load "load" at its end along +y.

    Args:
        lengths: of the links from the clamp, m; None: the most distal of the pair's.
    """

    def __init__(self, pair: DevicePair, numerics: Accuracy, lengths: Sequence[float] | None = None) -> None:
        if lengths is None:
            links = pair.links()
            count = next(n for n in range(1, len(links)) if sum(links[-n:]) >= CLAMPED - 1e-9)
            lengths = links[-count:]
        tables = device_tables(pair, numerics)
        both = sum(table.linear_density for table in tables if table)
        chain = dataclasses.replace(pair.chain(both, pair.radius), links=tuple(lengths))
        spec = new_spec(numerics)
        chain.add_to(spec.worldbody.add_body(name="clamp"), mass_scale=numerics.mass_scale, clamped=True)
        dead_load(spec, "load", np.array([0.0, 1.0, 0.0]))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.lengths = np.array(lengths)
        self.twist = np.zeros((DEVICES, len(lengths)))
        weights = np.tile(self.model.body_invweight0[-len(lengths) :], (2, 1, 1))
        rigid = pair.torsion == "rigid"
        self.rod = Rod(self.model, tables, lengths, weights, self.twist, rigid=rigid, clamped=True)

    def rest(self, lead: float, load: float = 0.0, angles: tuple[float, float] = (0.0, 0.0)) -> None:
        """Lets the chain come to rest at a lead (m), under a load (N), the devices' hubs turned by angles (rad)."""
        mujoco.mj_resetData(self.model, self.data)
        self.rod.place(lead, angles)
        self.data.ctrl[0] = load
        for _ in range(50):  # twist and bends in turn
            before = self.data.qpos.copy()
            self.rod.untwist(self.data)
            settle(self.model, self.data, speed=1e-5)
            if np.abs(self.data.qpos - before).max() < 1e-6:
                break

    @property
    def deflection(self) -> float:
        """Of the end along the load, m."""
        return float(self.data.actuator_length[0])

    def end_direction(self) -> Array:
        """Unit vector along the last link. Shape (3,)."""
        return self.data.geom_xmat[-1].reshape(3, 3)[:, 2].copy()


def straightened(pair: DevicePair) -> DevicePair:
    """The pair without its devices' unloaded shapes."""
    wire = dataclasses.replace(pair.wire, tip_angle=0.0, tip_length=0.0) if pair.wire else None
    catheter = dataclasses.replace(pair.catheter, shape=()) if pair.catheter else None
    return dataclasses.replace(pair, wire=wire, catheter=catheter)


def cantilever_cases(pair: DevicePair, numerics: Accuracy = ACCURACY["reference"]) -> list[TheoryCheck]:
    """Deflection over length at ten coverages, of the pair's own tapers, without the unloaded shapes."""
    straight = straightened(pair)
    assert straight.wire
    assert straight.catheter
    wire, catheter = straight.wire, straight.catheter
    clamped = ClampedPair(straight, numerics)
    length = float(clamped.lengths.sum())
    cases = []
    for lead in COVERAGES:

        def stiffness(from_clamp: float, lead: float = lead) -> float:
            along_wire = length - from_clamp + min(lead, 0.0)
            along_catheter = length - from_clamp - max(lead, 0.0)
            both = wire.stiffness(along_wire) if along_wire >= 0 else 0.0
            return both + (catheter.stiffness(along_catheter) if along_catheter >= 0 else 0.0)

        clamped.rest(lead, LOAD)
        exact = rod_deflection(LOAD, length, stiffness)
        cases.append(
            TheoryCheck("cantilever", f"lead {1e3 * lead:.0f} mm", clamped.deflection / length, exact / length)
        )
    return cases


def coaxial_angles(pair: DevicePair, lead: float, load: float) -> tuple[float, float]:
    """Angle of the chain's end (rad, about x), by the composite rod and by two rods on one centreline.

    The two rods keep their own energies of bending: nothing is mixed. Their common centreline, in steps of
    `COAXIAL_STEP`, is the one of least energy (Newton's method).

    Args:
        pair: wire and catheter, of planar shapes.
        lead: of the wire's tip, m, not negative.
        load: dead load at the end along +y, N.
    """
    assert pair.wire
    assert pair.catheter
    composite = ClampedPair(dataclasses.replace(pair, torsion="rigid"), ACCURACY["reference"])
    composite.rest(lead, load)
    axis = composite.end_direction()
    length = float(composite.lengths.sum())
    step = length / round(length / COAXIAL_STEP)
    from_end = length - step * (np.arange(round(length / step)) + 0.5)
    stiffness, moment = np.zeros(len(from_end)), np.zeros(len(from_end))
    for device, back in ((pair.wire, 0.0), (pair.catheter, lead)):
        there = from_end >= back
        bending = np.where(there, device.stiffness(np.maximum(from_end - back, 0.0)), 0.0)
        stiffness += bending
        moment += bending * device.rest_curvature(np.maximum(from_end - back, 0.0)).real
    curvature = moment / stiffness
    for _ in range(100):
        angle = np.cumsum(curvature) * step
        # a turn about +x moves what lies beyond towards -y: the end's deflection is -sum(sin(angle)) step
        beyond = step * np.cumsum(np.cos(angle)[::-1])[::-1]
        bent = step * np.cumsum(np.sin(angle)[::-1])[::-1]
        gradient = step * (stiffness * curvature - moment + load * beyond)
        order = np.arange(len(angle))
        hessian = -load * step**2 * bent[np.maximum(order[:, None], order[None, :])] + np.diag(step * stiffness)
        change = np.linalg.solve(hessian, gradient)
        curvature -= change
        if np.abs(change).max() < 1e-9:
            break
    return float(np.arctan2(-axis[1], axis[2])), float(np.sum(curvature) * step)


def coaxial_error_deg(pair: DevicePair, load: float = 0.0) -> float:
    """Largest angle between the ends of the composite rod and of two coaxial rods, over leads, degrees.

    Args:
        load: dead load at the end, N; with one, the chain's own links make most of the difference.
    """
    worst = 0.0
    for lead in COAXIAL_LEADS:
        ours, theirs = coaxial_angles(pair, lead, load)
        worst = max(worst, abs((ours - theirs + np.pi) % (2 * np.pi) - np.pi))
    return float(np.degrees(worst))


def theoretical_hub_angle(device: Catheter, tip_angle: float) -> float:
    """Hub angle (rad) of a device in a bent sheath from its tip's angle (rad) against the plane of the bend, by theory.

    In a sheath of curvature k the twist psi of a device of rest curvature k0 obeys (GJ psi')' = EI k k0 sin(psi), with
    psi' = 0 at the free tip: a pendulum's equation, which every tip angle solves for one hub angle. Proximally of the
    bend a straight shaft twists evenly. Where the hub angle falls while the tip's grows, the tip whips round.
    """

    def slope(s: float, y: Array) -> tuple[float, float]:
        moment = device.stiffness(s) * SHEATH_BEND * device.rest_curvature(s).real * np.sin(y[0])
        return y[1] / device.torsional_stiffness(s), moment

    solution = solve_ivp(slope, (0, SHEATH_ARC), (tip_angle, 0.0), rtol=1e-9, atol=1e-12, max_step=5e-4)
    angle, moment = solution.y[:, -1]
    shaft = device.length - SHEATH_ARC
    return float(angle + moment * shaft / device.torsional_stiffness(SHEATH_ARC + shaft / 2))


def tips_in_bent_sheath(device: Catheter, hub_angles: Sequence[float], *, link: float = 0.002) -> Array:
    """Angles of the tip (rad) of a device that is turned in a bent sheath, with the simulator's twist. Shape (n,).

    The device's tip lies at the end of a bend of `SHEATH_BEND` and `SHEATH_ARC`, whose plane is that of angle 0.

    Args:
        device: of one stiffness from the tip to the hub, or of a taper within the bend.
        hub_angles: one after the other, rad.
        link: length of the chain's links, m.
    """
    straight = round(0.02 / link)
    links = (link,) * (straight + round(SHEATH_ARC / link))
    chain = ClampedPair(DevicePair(None, device, reach=sum(links)), ACCURACY["reference"], links)
    chain.data.qpos.reshape(-1, 2)[straight:, 0] = SHEATH_BEND * link
    tips = []
    for angle in hub_angles:
        chain.rod.place(0.0, (0.0, angle))
        chain.rod.untwist(chain.data)
        tips.append(float(chain.twist[CATHETER, -1]))
    return np.array(tips)


def default_pair() -> DevicePair:
    """The default wire in a tapered catheter with a bent tip."""
    return DevicePair(load_guidewire("default"), Catheter(shape=((0.0, 0.012, np.radians(40.0), 0.0),)))
