"""The simulated rods of one and two devices against theory.

The composite rod of two devices: cantilevers, two rods held coaxial, twist in a bent sheath.
"""

import dataclasses
import math
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.rod import CATHETER, DEVICES, Rod, device_tables
from cathsim.guidewire import load_guidewire
from cathsim.physics_checks import AIM_PCT
from cathsim.physics_checks.rig import dead_load, new_spec, settle, uniform_wire
from cathsim.physics_checks.statics import (
    EI,
    STIFFNESS_NMM2,
    Column,
    cantilever_deflection,
    elastica_deflection,
    rod_deflection,
)
from cathsim.physics_checks.unguided import pushed_forces
from cathsim.presets import ACCURACY, Accuracy

Array = NDArray[np.float64]

# leads of wire before catheter, m: the last one leaves the wire's end out of the catheter
COVERAGES = (0.0, 0.013, 0.05, 0.13, -0.031)
CLAMPED = 0.25  # length of the clamped chain, m
LOAD = 0.01  # dead load of the cantilevers, N
COAXIAL_STEP = 0.5e-3  # of two coaxial rods' common centreline, m
COAXIAL_LEADS = (0.0, 0.005, 0.013, 0.027, 0.060)  # m
SHEATH_BEND, SHEATH_ARC = 40.0, 0.060  # curvature of a bent sheath, 1/m, and length of the bend, m


# the default wire in a tapered catheter with a bent tip
PAIR = DevicePair(load_guidewire("default"), Catheter(shape=((0.0, 0.012, np.radians(40.0), 0.0),)))


class ClampedPair:
    """The chain of two devices, clamped where it begins, with a dead load "load" at its end along +y.

    Its links have the given lengths (m) from the clamp; without them it is the most distal ones of the pair's.
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

    def rest(self, lead: float, load: float = 0.0) -> None:
        """Lets the chain come to rest at a lead (m), under a load (N)."""
        mujoco.mj_resetData(self.model, self.data)
        self.rod.place(lead, (0.0, 0.0))
        self.data.ctrl[0] = load
        for _ in range(50):  # twist and bends in turn
            before = self.data.qpos.copy()
            self.rod.untwist(self.data)
            settle(self.model, self.data, speed=1e-5)
            if np.abs(self.data.qpos - before).max() < 1e-6:
                break


def coaxial_angles(lead: float) -> tuple[float, float]:
    """Angle of the chain's end (rad, about x), by the composite rod and by two rods on one centreline.

    The two rods keep their own energies of bending: nothing is mixed. Their common centreline, in steps of
    `COAXIAL_STEP`, is the one of least energy. Both shapes are planar, the lead of the wire's tip (m) not negative.
    """
    composite = ClampedPair(dataclasses.replace(PAIR, torsion="rigid"), ACCURACY["reference"])
    composite.rest(lead)
    axis = composite.data.geom_xmat[-1].reshape(3, 3)[:, 2]
    length = float(composite.lengths.sum())
    step = length / round(length / COAXIAL_STEP)
    from_end = length - step * (np.arange(round(length / step)) + 0.5)
    stiffness, moment = np.zeros(len(from_end)), np.zeros(len(from_end))
    for device, back in ((PAIR.wire, 0.0), (PAIR.catheter, lead)):
        there = from_end >= back
        bending = np.where(there, device.stiffness(np.maximum(from_end - back, 0.0)), 0.0)
        stiffness += bending
        moment += bending * device.rest_curvature(np.maximum(from_end - back, 0.0)).real
    return float(np.arctan2(-axis[1], axis[2])), float(np.sum(moment / stiffness) * step)


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


def tips_in_bent_sheath(device: Catheter, hub_angles: Sequence[float]) -> Array:
    """Angles of the tip (rad) of a device that is turned in a bent sheath, with the simulator's twist. Shape (n,).

    The device's tip lies at the end of a bend of `SHEATH_BEND` and `SHEATH_ARC`, whose plane is that of angle 0. The
    device is of one stiffness from the tip to the hub, or of a taper within the bend.
    """
    link = 0.002  # m
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


def test_small_loads_bend_by_the_linear_law_and_large_ones_less() -> None:
    assert elastica_deflection(1e-3) == pytest.approx(1e-3 / 3, rel=1e-4)
    # Bisshopp and Drucker 1945: P L^2 / EI = 1 and 10
    assert elastica_deflection(1.0) == pytest.approx(0.30172, abs=2e-5)
    assert elastica_deflection(10.0) == pytest.approx(0.81061, abs=2e-5)
    # shooting agrees with the elliptic integrals
    length = 0.2
    deflection = rod_deflection(2 * EI / length**2, length, lambda s: EI)
    assert deflection / length == pytest.approx(elastica_deflection(2.0), rel=1e-5)


def test_a_simulated_cantilever_and_column_follow_theory() -> None:
    wire = uniform_wire((0.012,) * 22, STIFFNESS_NMM2)
    numerics = ACCURACY["accurate"]
    deflection = cantilever_deflection(wire, 2 * EI / wire.length**2, numerics)
    assert deflection / wire.length == pytest.approx(elastica_deflection(2.0), rel=AIM_PCT["elastica"] / 100)
    critical = Column.clamped_free(wire, numerics).critical_by_stiffness(1e-5)
    assert critical == pytest.approx(math.pi**2 * EI / (4 * wire.length**2), rel=AIM_PCT["buckling"] / 100)


BENT = Catheter(
    shape=((0.0, 0.06, 1.8, 0.0),),
    torsional_stiffness_nmm2=300.0,
    taper=(0.0, 0.0),
    tip_stiffness_nmm2=300.0,
    length=0.1,
)


def test_a_cantilever_bends_as_both_stiffnesses_together() -> None:
    """At every coverage, by the pair's own tapers, without the unloaded shapes."""
    wire = dataclasses.replace(PAIR.wire, tip_angle=0.0, tip_length=0.0)
    catheter = dataclasses.replace(PAIR.catheter, shape=())
    clamped = ClampedPair(dataclasses.replace(PAIR, wire=wire, catheter=catheter), ACCURACY["reference"])
    length, deflections = float(clamped.lengths.sum()), []
    for lead in COVERAGES:

        def stiffness(from_clamp: float, lead: float = lead) -> float:
            along_wire = length - from_clamp + min(lead, 0.0)
            along_catheter = length - from_clamp - max(lead, 0.0)
            both = wire.stiffness(along_wire) if along_wire >= 0 else 0.0
            return both + (catheter.stiffness(along_catheter) if along_catheter >= 0 else 0.0)

        clamped.rest(lead, LOAD)
        deflections.append(rod_deflection(LOAD, length, stiffness))
        assert float(clamped.data.actuator_length[0]) == pytest.approx(deflections[-1], rel=0.005), lead
    assert len({round(deflection / length, 4) for deflection in deflections}) == len(COVERAGES)


def test_the_end_points_as_that_of_two_coaxial_rods() -> None:
    apart = [ours - theirs for ours, theirs in map(coaxial_angles, COAXIAL_LEADS)]
    assert np.degrees(np.abs((np.array(apart) + np.pi) % (2 * np.pi) - np.pi)).max() < 0.05


def test_the_tip_lags_behind_the_hub_as_in_theory() -> None:
    hubs = np.linspace(0.0, np.radians(310.0), 20)
    tips = tips_in_bent_sheath(BENT, hubs)
    theory = [theoretical_hub_angle(BENT, tip) for tip in tips]
    assert np.degrees(hubs[-1] - tips[-1]) > 200
    assert np.degrees(np.abs(theory - hubs)).max() < 0.5


def test_the_tip_whips_at_the_hub_angle_of_theory() -> None:
    critical = max(theoretical_hub_angle(BENT, tip) for tip in np.linspace(0.5, 2.5, 21))
    hubs = np.radians(np.arange(300.0, 340.0, 1.0))
    tips = tips_in_bent_sheath(BENT, hubs)
    whip = int(np.argmax(np.diff(tips)))
    assert np.diff(tips)[whip] > np.pi
    assert np.degrees(hubs[whip + 1]) == pytest.approx(np.degrees(critical), abs=2.0)


def test_pushed_forces_repeat_with_their_seed() -> None:
    first = pushed_forces("type_1", 6, seed=1)
    assert first.shape == (6,)
    assert (first >= 0).all()
    np.testing.assert_array_equal(first, pushed_forces("type_1", 6, seed=1))
