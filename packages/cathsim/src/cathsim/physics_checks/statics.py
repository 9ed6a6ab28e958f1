"""Statics of the free wire: the cantilever under a dead load (elastica), the column at its critical load (Euler)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import mujoco
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from cathsim.guidewire import LINK_NAME, Guidewire, load_guidewire
from cathsim.physics_checks.rig import TheoryCheck, dead_load, new_spec, settle, uniform_wire
from cathsim.presets import ACCURACY, Accuracy

STIFFNESS_NMM2 = 400.0
EI = STIFFNESS_NMM2 * 1e-6
DEFAULT_LINKS = load_guidewire("default").links
CHAINS = {"default links": DEFAULT_LINKS, "22 x 12 mm": (0.012,) * 22}


def elastica_deflection(load: float) -> float:
    """Tip deflection over length of a cantilever under a dead load across its unbent axis, by elliptic integrals.

    Args:
        load: P L^2 / EI.
    """

    def modulus(tip_angle: float) -> tuple[float, float]:
        m = (1 + math.sin(tip_angle)) / 2
        return m, math.asin(math.sqrt(0.5 / m))

    def mismatch(tip_angle: float) -> float:
        m, phi = modulus(tip_angle)
        return float(ellipk(m) - ellipkinc(phi, m)) - math.sqrt(load)

    m, phi = modulus(brentq(mismatch, 1e-12, math.pi / 2 - 1e-12, xtol=1e-15))
    return 1 - 2 / math.sqrt(load) * float(ellipe(m) - ellipeinc(phi, m))


def rod_deflection(load: float, length: float, stiffness: Callable[[float], float]) -> float:
    """Tip deflection (m) of a cantilever whose bending stiffness varies, by shooting.

    Args:
        load: dead load across the unbent axis, N.
        length: m.
        stiffness: EI (N m^2) as a function of the distance from the clamp, m.
    """

    def slope(s: float, y: np.ndarray) -> tuple[float, float, float]:
        # angle, moment, deflection
        return y[1] / stiffness(s), -load * math.cos(y[0]), math.sin(y[0])

    def tip(root_moment: float) -> np.ndarray:
        solution = solve_ivp(slope, (0, length), (0.0, root_moment, 0.0), rtol=1e-9, atol=1e-12, max_step=length / 200)
        return solution.y[:, -1]

    # a dead load's lever is at most the length
    moment = brentq(lambda root: tip(root)[1], 0.0, load * length, rtol=1e-9)
    return float(tip(moment)[2])


def cantilever_deflection(wire: Guidewire, load: float, numerics: Accuracy) -> float:
    """Simulated tip deflection (m) of a clamped wire at rest under a dead load (N) across its unbent axis."""
    spec = new_spec(numerics)
    wire.add_to(spec.worldbody.add_body(name="clamp"), mass_scale=numerics.mass_scale, clamped=True)
    dead_load(spec, "load", np.array([0.0, 1.0, 0.0]))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = load
    settle(model, data)
    return float(data.actuator_length[0])


def elastica_cases() -> list[TheoryCheck]:
    """Deflection over length of cantilevers at every preset's timestep, of uniform stiffness and of the default's."""
    cases = []
    for preset, numerics in ACCURACY.items():
        for chain, links in CHAINS.items():
            wire = uniform_wire(links, STIFFNESS_NMM2)
            for load in (1.0, 2.0, 5.0, 10.0):
                deflection = cantilever_deflection(wire, load * EI / wire.length**2, numerics)
                name = f"PL²/EI {load:g}, {chain}, {preset} {1e3 * numerics.timestep:g} ms"
                cases.append(TheoryCheck("elastica", name, deflection / wire.length, elastica_deflection(load)))
    wire = load_guidewire("default", tip_angle=0.0, tip_length=0.0)
    for load in (0.005, 0.02):
        deflection = cantilever_deflection(wire, load, ACCURACY["accurate"])
        exact = rod_deflection(load, wire.length, lambda s: wire.stiffness(wire.length - s))
        name = f"default taper, {1e3 * load:g} mN, accurate {1e3 * ACCURACY['accurate'].timestep:g} ms"
        cases.append(TheoryCheck("elastica", name, deflection / wire.length, exact / wire.length))
    return cases


@dataclasses.dataclass
class Column:
    """A straight wire under a dead axial load (actuator "load") and a small sideways force (actuator "probe")."""

    model: mujoco.MjModel
    data: mujoco.MjData

    @staticmethod
    def clamped_free(wire: Guidewire, numerics: Accuracy) -> Column:
        """Clamped below, free above: critical at pi^2 EI / (4 L^2)."""
        spec = new_spec(numerics)
        wire.add_to(spec.worldbody.add_body(name="clamp"), mass_scale=numerics.mass_scale, clamped=True)
        dead_load(spec, "load", np.array([0.0, 0.0, -1.0]))
        dead_load(spec, "probe", np.array([0.0, 1.0, 0.0]))
        model = spec.compile()
        return Column(model, mujoco.MjData(model))

    @staticmethod
    def pinned_pinned(wire: Guidewire, numerics: Accuracy) -> Column:
        """Free to turn at both ends, the upper one guided along the axis: critical at pi^2 EI / L^2."""
        spec = new_spec(numerics)
        pin = spec.worldbody.add_body(name="pin")
        for axis in ([1, 0, 0], [0, 1, 0]):
            pin.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, armature=1e-9)
        wire.add_to(pin, mass_scale=numerics.mass_scale)
        guide = spec.worldbody.add_body(name="guide", pos=[0, 0, wire.length])
        guide.mass, guide.inertia, guide.explicitinertial = 1e-3, [1e-9] * 3, True
        guide.add_joint(name="guide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        guide.add_site(name="guide")
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1="tip",
            name2="guide",
            solref=[0.004, 1.0],
            solimp=[0.999, 0.9999, 0.001, 0.5, 2.0],
        )
        middle = int(np.argmin(np.abs(np.cumsum(wire.links) - wire.length / 2))) + 1
        spec.body(LINK_NAME.format(middle)).add_site(name="middle")
        dead_load(spec, "load", np.array([0.0, 0.0, -1.0]), "guide")
        dead_load(spec, "probe", np.array([0.0, 1.0, 0.0]), "middle")
        model = spec.compile()
        return Column(model, mujoco.MjData(model))

    def _loaded(self, load: float, probe: float) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.actuator("load").ctrl, self.data.actuator("probe").ctrl = load, probe

    def stiffness(self, load: float, probe: float) -> float:
        """Sideways stiffness (N/m) at rest under an axial load (N), from the deflection by the probe (N)."""
        self._loaded(load, probe)
        settle(self.model, self.data, speed=1e-7)
        return probe / float(self.data.actuator("probe").length[0])

    def critical_by_stiffness(self, probe: float) -> float:
        """Load (N) at which the sideways stiffness vanishes, by secants from below."""
        loads = [0.0]
        values = [self.stiffness(0.0, probe)]
        # the first load is small beside the stiffness over the column's length
        loads.append(0.2 * values[0] * self.data.site("tip").xpos[2])
        values.append(self.stiffness(loads[1], probe))
        for share in (0.8, 0.95, 1.0):
            critical = loads[-1] + values[-1] * (loads[-1] - loads[-2]) / (values[-2] - values[-1])
            if share < 1:
                loads.append(share * critical)
                values.append(self.stiffness(loads[-1], probe))
        return float(critical)

    def grows(self, load: float, probe: float) -> bool:
        """Whether a small sideways push (N, for 0.1 s) goes on growing under an axial load (N)."""
        self._loaded(load, probe)
        steps = round(1.0 / self.model.opt.timestep)
        largest = []
        for second in range(6):
            deflection = 0.0
            for i in range(steps):
                if second == 0 and i == steps // 10:
                    self.data.actuator("probe").ctrl = 0.0
                mujoco.mj_step(self.model, self.data)
                deflection = max(deflection, abs(float(self.data.actuator("probe").length[0])))
            largest.append(deflection)
        # from the fourth second on the faster modes have died out; what has died out altogether is rounding
        return largest[5] > largest[3] > 1e-3 * largest[0]

    def critical_by_growth(self, probe: float) -> float:
        """Load (N) that separates pushes that die out from pushes that grow, by bisection."""
        low, high = 0.0, 1e-3
        while not self.grows(high, probe):
            low, high = high, 2 * high
        while high - low > 2e-4 * high:
            middle = (low + high) / 2
            low, high = (low, middle) if self.grows(middle, probe) else (middle, high)
        return (low + high) / 2


def buckling_cases() -> list[TheoryCheck]:
    """Critical loads (N), found by two independent procedures for two supports."""
    cases = []
    numerics = dataclasses.replace(ACCURACY["reference"], timestep=0.002)
    supports = {"clamped-free": (Column.clamped_free, 0.25), "pinned-pinned": (Column.pinned_pinned, 1.0)}
    for support, (build, factor) in supports.items():
        for chain, links in CHAINS.items():
            wire = uniform_wire(links, STIFFNESS_NMM2)
            theory = factor * math.pi**2 * EI / wire.length**2
            column, name = build(wire, numerics), f"{support}, {chain}"
            cases.append(
                TheoryCheck("buckling", f"{name}, stiffness to zero", column.critical_by_stiffness(1e-5), theory)
            )
            cases.append(TheoryCheck("buckling", f"{name}, growth", column.critical_by_growth(1e-6), theory))
    return cases
