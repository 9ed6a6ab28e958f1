"""Guidewires: presets, profiles, theory; the part of the wire that is simulated."""

import dataclasses

import mujoco
import numpy as np
import pytest

from cathsim import NavigateEnv, Phantom, Simulation, load_phantom
from cathsim.anatomy import SignedDistanceGrid
from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import compiled_model, max_insertion, model_spec
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.environment import TRANSLATION_STEP
from cathsim.guidewire import GUIDEWIRES, TIP_SITE, Guidewire, load_guidewire, preset_of
from cathsim.metrics.failure_modes import ABORTED, OVERSHOOT, STUCK, WRONG_BRANCH, failure_mode, places
from cathsim.presets import ACCURACY

EI = 4.0e-4  # N m^2


def straight(links: tuple[float, ...] = Guidewire().links) -> Guidewire:
    return load_guidewire(
        "default", tip_angle=0.0, tip_length=0.0, shaft_stiffness_nmm2=400.0, tip_stiffness_nmm2=400.0, links=links
    )


def cantilever(wire: Guidewire, preset: str) -> mujoco.MjModel:
    """A clamped wire with a dead load along +y as its only control."""
    numerics = ACCURACY[preset]
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep, spec.option.gravity = numerics.timestep, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.worldbody.add_site(name="world")
    wire.add_to(spec.worldbody.add_body(name="clamp"), mass_scale=numerics.mass_scale, clamped=True)
    load = spec.add_actuator(name="load", target=TIP_SITE, refsite="world", trntype=mujoco.mjtTrn.mjTRN_SITE)
    load.set_to_motor()
    load.gear = [0, 1, 0, 0, 0, 0]
    return spec.compile()


def tip_at_rest(model: mujoco.MjModel, load: float, seconds: float) -> np.ndarray:
    data = mujoco.MjData(model)
    data.ctrl[0] = load
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    mujoco.mj_kinematics(model, data)
    assert np.abs(data.qvel).max() < 1e-4, "not at rest"
    return data.site(TIP_SITE).xpos.copy()


@pytest.fixture(scope="module")
def space() -> Vessel:
    """Free space: a wall a metre away."""
    return Vessel(SignedDistanceGrid(np.ones((3, 3, 3)), np.zeros(3), 1.0), np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("name", GUIDEWIRES)
def test_preset_is_a_wire_that_compiles(name: str, space: Vessel) -> None:
    wire = load_guidewire(name)
    model = model_spec(space, wire, ACCURACY["accurate"]).compile()
    assert model.nv == 2 + 2 * wire.joints
    assert max_insertion(wire) > 0.2
    # total mass, the hemispherical ends of the capsules included
    volume = np.pi * wire.radius**2 * wire.length + len(wire.links) * 4 / 3 * np.pi * wire.radius**3
    assert model.body_mass.sum() == pytest.approx(10 * wire.density * volume, rel=1e-9)


@pytest.mark.parametrize("name", ["default", "radifocus_angled_025"])
def test_a_wire_of_a_log_without_torsion_is_its_preset(name: str) -> None:
    fields = dataclasses.asdict(load_guidewire(name))
    del fields["torsional_stiffness_nmm2"], fields["working_length"]
    assert preset_of(Guidewire(**fields)) == (name, 0.0)


@pytest.mark.parametrize("preset", ["accurate", "fast"])
def test_elastica(preset: str) -> None:
    """P L^2 / EI = 2 bends the tip of a cantilever by 0.4935 of its length, at every timestep."""
    wire = straight()
    tip = tip_at_rest(cantilever(wire, preset), 2 * EI / wire.length**2, 30.0)
    assert tip[1] / wire.length == pytest.approx(0.493457, rel=0.003)
    assert abs(tip[0]) < 1e-9


def test_unloaded_tip_is_bent_by_its_angle() -> None:
    wire = load_guidewire("default")
    model = cantilever(wire, "accurate")
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    mujoco.mj_kinematics(model, data)
    axis = data.site(TIP_SITE).xmat.reshape(3, 3)[:, 2]
    assert np.degrees(np.arccos(axis[2])) == pytest.approx(80.0, abs=0.5)


@pytest.mark.parametrize("name", list(GUIDEWIRES))
def test_a_preset_is_known_again_also_where_it_was_scaled(name: str) -> None:
    wire = load_guidewire(name)
    assert preset_of(wire) == (name, 0.0)
    longer = wire.scaled(wire.length + 0.1)
    assert preset_of(longer) == (name, longer.length)
    assert preset_of(load_guidewire(name, friction=0.123)) is None


def test_the_tip_of_arch_variety_is_an_arc_of_72_degrees(space: Vessel) -> None:
    wire = load_guidewire("arch_variety")
    assert wire.length == pytest.approx(0.450, abs=1e-6)
    assert abs(wire.rest_curvature(0.005)) == pytest.approx(1 / 12.1e-3, rel=1e-4)
    model = model_spec(space, wire, ACCURACY["accurate"]).compile()
    assert np.degrees(model.qpos_spring[2:].sum()) == pytest.approx(72.0, abs=0.01)


@pytest.mark.parametrize(("friction", "dimensions"), [(0.06, 3), (0.002, 3), (0.001, 1)])
def test_contacts_of_hardly_any_friction_push_alone(friction: float, dimensions: int, space: Vessel) -> None:
    wire = load_guidewire("default", friction=friction)
    pair = DevicePair(load_guidewire("default", friction=0.0), load_catheter("vertebral", friction=friction))
    for one in (wire, pair.chain(0.01, 1e-3)):
        assert (compiled_model(space, one, ACCURACY["fast"]).geom_condim[-len(one.links) :] == dimensions).all()


DEFAULT = load_guidewire("default")
LONG = DEFAULT.scaled(0.6)


def feed(simulation: Simulation, steps: int, translation: float = TRANSLATION_STEP) -> None:
    for step in range(steps):
        simulation.advance(translation, 0.1 * np.sin(step))


def test_only_the_inserted_part_of_a_long_wire_is_simulated_and_its_state_comes_back(type_1: Phantom) -> None:
    default, long = (Simulation(type_1, wire, ACCURACY["fast"]) for wire in (DEFAULT, LONG))
    assert len(LONG.links) == len(DEFAULT.links) + 21
    for _ in range(5):
        for simulation in (default, long):
            feed(simulation, 10)
        assert long.active_links == default.active_links < 22
        assert long.model.nv == default.model.nv
        assert long.model.nM == default.model.nM
        assert np.abs(long.tip - default.tip).max() < 1e-4, "the wire in the sheath changes nothing"
    assert long.insertion == pytest.approx(0.1, abs=0.005)
    state = long.state()
    feed(long, 5)
    tip = long.tip
    feed(long, 20, -TRANSLATION_STEP)
    long.restore(state)
    feed(long, 5)
    assert np.array_equal(long.tip, tip)


def test_a_wire_too_short_for_its_target_says_which_would_do(type_1: Phantom) -> None:
    short = DEFAULT.scaled(0.2)
    with pytest.raises(ValueError, match=r"200 mm is too short for rcca_end of type_1, 23\d mm from.*scaled\(0.28\)"):
        NavigateEnv(type_1, "rcca_end", wire=short)
    assert NavigateEnv(type_1, "rcca_end", wire=DEFAULT.scaled(0.28)).simulation.max_insertion > 0.23
    # a target nearer than the end of the way needs less
    assert NavigateEnv(type_1, "lsa_end", wire=DEFAULT.scaled(0.23)).simulation.wire.length < DEFAULT.length
    with pytest.raises(ValueError, match="too short for lcca_end of bovine"):
        NavigateEnv(load_phantom("bovine"), "lcca_end", wire="thesis")


def test_failure_modes() -> None:
    phantom = load_phantom("type_1")
    tree = {branch.name: branch for branch in phantom.tree.branches}
    aorta, steps = tree["aorta"], 60

    def mode(end: np.ndarray, target: str = "lcca") -> str:
        way = np.concatenate((aorta.points[:20], np.repeat(end[None], steps - 19, axis=0)))
        return failure_mode(phantom, target, way, steps_allowed=steps, entry="descending")

    assert places(phantom, tree["lsa"].point_at([0.05]))[0] == ["lsa"]
    assert mode(tree["lsa"].point_at(0.05)) == WRONG_BRANCH
    assert mode(tree["bca"].point_at(0.045)) == WRONG_BRANCH
    assert mode(tree["lcca"].point_at(0.04)) == STUCK
    assert mode(tree["rsa"].point_at(0.02), "bca") == WRONG_BRANCH
    take_off = tree["lcca"].parent_arc
    assert mode(aorta.point_at(take_off - 0.03)) == STUCK
    assert mode(aorta.point_at(take_off + 0.005)) == STUCK
    assert mode(aorta.point_at(take_off + 0.03)) == OVERSHOOT
    short = failure_mode(phantom, "lcca", aorta.points[:30], steps_allowed=steps, entry="descending")
    assert short == ABORTED
