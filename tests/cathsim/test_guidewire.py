"""The guidewire: presets, stiffness profile, changes of length, refusals, and its statics against the elastica."""

from __future__ import annotations

import dataclasses
import itertools

import mujoco
import numpy as np
import pytest

from cathsim.anatomy import SignedDistanceGrid
from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import PROTRUSION, compiled_model, max_insertion, model_spec
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import GUIDEWIRES, LINK_NAME, TIP_SITE, Guidewire, load_guidewire, preset_of
from cathsim.presets import ACCURACY, accuracy

EI = 4.0e-4  # N m^2


def straight(links: tuple[float, ...] = Guidewire().links) -> Guidewire:
    return load_guidewire(
        "default", tip_angle=0.0, tip_length=0.0, shaft_stiffness_nmm2=400.0, tip_stiffness_nmm2=400.0, links=links
    )


def cantilever(wire: Guidewire, preset: str) -> mujoco.MjModel:
    """A clamped wire with a dead load along +y as its only control."""
    numerics = accuracy(preset)
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


@pytest.mark.parametrize(("name", "freedoms"), [("default", 56), ("thesis", 168)])
def test_degrees_of_freedom(name: str, freedoms: int, space: Vessel) -> None:
    assert model_spec(space, load_guidewire(name), ACCURACY["accurate"]).compile().nv == freedoms


def test_tip_motors_are_limited_to_their_angle(space: Vessel) -> None:
    wire = load_guidewire("default")
    model = model_spec(space, wire, ACCURACY["accurate"], tip_motors=True).compile()
    assert model.nu == 2 + 2 * wire.motor_joints
    last = model.joint(f"{LINK_NAME.format(wire.joints)}x")
    assert model.actuator_ctrlrange[-2, 1] == pytest.approx(last.stiffness[0] * wire.motor_angle)


def test_stiffness_profile() -> None:
    wire = Guidewire()
    near, far = wire.taper
    assert wire.stiffness(0.0) == wire.stiffness(near) == pytest.approx(wire.tip_stiffness_nmm2 * 1e-6)
    assert wire.stiffness(far) == wire.stiffness(1.0) == pytest.approx(wire.shaft_stiffness_nmm2 * 1e-6)
    # its logarithm is linear between: the geometric mean halfway
    mean = np.sqrt(wire.tip_stiffness_nmm2 * wire.shaft_stiffness_nmm2) * 1e-6
    assert wire.stiffness((near + far) / 2) == pytest.approx(mean)
    profile = [wire.stiffness(s) for s in np.linspace(0, 0.1, 50)]
    assert all(a <= b for a, b in itertools.pairwise(profile))


def test_profiles_take_arrays() -> None:
    wire = Guidewire()
    distance = np.linspace(0.0, 0.1, 23)
    assert wire.stiffness(distance).tolist() == pytest.approx([wire.stiffness(s) for s in distance], rel=1e-14)
    assert wire.torsional_stiffness(distance) == pytest.approx(wire.stiffness(distance) / 1.33)
    curvature = wire.rest_curvature(distance)
    assert curvature.tolist() == [wire.rest_curvature(s) for s in distance]
    assert type(wire.stiffness(0.01)) is type(wire.torsional_stiffness(0.01)) is float


def test_rest_curvature_is_the_tips_angle_over_its_length() -> None:
    wire = Guidewire()
    assert wire.rest_curvature(wire.tip_length / 2) == pytest.approx(wire.tip_angle / wire.tip_length)
    assert wire.rest_curvature(-1e-3) == wire.rest_curvature(wire.tip_length + 1e-3) == 0
    assert load_guidewire("nitrex_straight").rest_curvature(0.0) == 0


def test_torsion_follows_bending_unless_it_is_given() -> None:
    wire = Guidewire(shaft_stiffness_nmm2=266.0, torsional_stiffness_nmm2=100.0)
    assert wire.torsional_stiffness(1.0) == pytest.approx(100e-6)
    assert dataclasses.replace(wire, torsional_stiffness_nmm2=None).torsional_stiffness(1.0) == pytest.approx(200e-6)


def test_torsion_leaves_the_bare_wires_model_as_it_is(space: Vessel) -> None:
    wire = Guidewire()
    twisting = dataclasses.replace(wire, torsional_stiffness_nmm2=50.0, working_length=2.6)
    one, other = (model_spec(space, each, ACCURACY["accurate"]).to_xml() for each in (wire, twisting))
    assert one == other


@pytest.mark.parametrize("name", ["default", "thesis", "radifocus_angled", "radifocus_angled_025", "nitrex_straight"])
def test_a_wire_of_a_log_without_torsion_is_its_preset(name: str) -> None:
    fields = dataclasses.asdict(load_guidewire(name))
    del fields["torsional_stiffness_nmm2"], fields["working_length"]
    assert preset_of(Guidewire(**fields)) == (name, 0.0)


def test_hinges_have_the_rods_compliance(space: Vessel) -> None:
    """Joint compliances of a uniform wire add up to length / EI between the middles of the first and last link."""
    wire = straight()
    model = model_spec(space, wire, ACCURACY["accurate"]).compile()
    compliance = (1 / model.jnt_stiffness[2::2]).sum()
    assert compliance == pytest.approx((wire.length - wire.links[0] / 2 - wire.links[-1] / 2) / EI)


@pytest.mark.parametrize("preset", ["accurate", "fast"])
def test_elastica(preset: str) -> None:
    """P L^2 / EI = 2 bends the tip of a cantilever by 0.4935 of its length, at every timestep."""
    wire = straight()
    tip = tip_at_rest(cantilever(wire, preset), 2 * EI / wire.length**2, 30.0)
    assert tip[1] / wire.length == pytest.approx(0.493457, rel=0.003)
    assert abs(tip[0]) < 1e-9


@pytest.mark.parametrize("count", [11, 66])
def test_deflection_does_not_depend_on_the_resolution(count: int) -> None:
    wire = straight((0.264 / count,) * count)
    tip = tip_at_rest(cantilever(wire, "reference"), EI / wire.length**2, 3.0)
    assert tip[1] / wire.length == pytest.approx(0.301721, rel=0.005)


def test_unloaded_tip_is_bent_by_its_angle() -> None:
    wire = load_guidewire("default")
    model = cantilever(wire, "accurate")
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    mujoco.mj_kinematics(model, data)
    axis = data.site(TIP_SITE).xmat.reshape(3, 3)[:, 2]
    assert np.degrees(np.arccos(axis[2])) == pytest.approx(80.0, abs=0.5)


def test_scaled_changes_the_proximal_end_only() -> None:
    wire = Guidewire()
    longer, shorter = wire.scaled(0.400), wire.scaled(0.150)
    assert 0.400 <= longer.length + 1e-9 < 0.400 + wire.links[0] + 1e-9
    assert 0.150 <= shorter.length + 1e-9 < 0.150 + wire.links[0] + 1e-9
    assert longer.links[-len(wire.links) :] == wire.links
    assert shorter.links == wire.links[-len(shorter.links) :]
    assert wire.scaled(wire.length) == wire
    assert dataclasses.replace(longer, links=wire.links) == wire


def test_distal_keeps_the_tip() -> None:
    wire = Guidewire()
    end = wire.distal(12)
    assert end.links == wire.links[-12:]
    assert end.stiffness(0.04) == wire.stiffness(0.04)
    assert wire.distal(len(wire.links)) == wire


def test_first_link_lies_in_the_sheath(space: Vessel) -> None:
    """The tip of the straight wire stands out of the sheath by PROTRUSION."""
    model = model_spec(space, straight(), ACCURACY["accurate"]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.site(TIP_SITE).xpos, [0, 0, PROTRUSION], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"links": (0.01,)}, "links needs at least 2 entries, got 1"),
        ({"links": (0.01, -0.01)}, r"links\[1\] must lie in 0 \(excluded\) to 0.5 m, got -0.01"),
        ({"links": (0.01, 0.0005)}, "shorter than the diameter"),
        ({"diameter": 0.0}, r"diameter must lie in 0 \(excluded\) to 0.01 m, got 0.0"),
        ({"shaft_stiffness_nmm2": -1.0}, "shaft_stiffness_nmm2 must lie in"),
        ({"tip_stiffness_nmm2": np.nan}, "tip_stiffness_nmm2 must be a finite number"),
        ({"density": 0.0}, "density must lie in"),
        ({"friction": -0.1}, "friction must lie in 0 to 10, got -0.1"),
        ({"relaxation": -0.1}, "relaxation must lie in 0 to 100 s, got -0.1"),
        ({"taper": (0.06, 0.02)}, "two increasing distances"),
    ],
)
def test_impossible_wire_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_guidewire("default", **changes)


def test_unknown_preset_lists_the_valid_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown guidewire 'steel'.*default, thesis, radifocus_angled"):
        load_guidewire("steel")


def test_unknown_field_lists_the_valid_ones() -> None:
    with pytest.raises(ValueError, match=r"has no stiffness.*shaft_stiffness_nmm2"):
        load_guidewire("default", stiffness=3.0)


def test_unknown_accuracy_lists_the_valid_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown accuracy 'exact'.*reference, accurate, fast"):
        accuracy("exact")


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
def test_contacts_of_hardly_any_friction_have_a_normal_force_alone(
    friction: float, dimensions: int, space: Vessel
) -> None:
    wire = load_guidewire("default", friction=friction)
    pair = DevicePair(load_guidewire("default", friction=0.0), load_catheter("vertebral", friction=friction))
    for one in (wire, pair.chain(0.01, 1e-3)):
        assert (compiled_model(space, one, accuracy("fast")).geom_condim[-len(one.links) :] == dimensions).all()
