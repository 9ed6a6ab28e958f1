"""Blood: profiles and their limits, conservation of mass in the vessels, drag on cylinders and on the wire."""

import ctypes
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cathsim import Phantom, Simulation, load_guidewire
from cathsim.anatomy.generator.random_tree import RandomTree, build_random_tree
from cathsim.blood.drag import Drag
from cathsim.blood.field import BloodField, blood_field
from cathsim.blood.flow import FLOWS, BloodFlow, descending_shares, outlet_shares
from cathsim.blood.picture import picture
from cathsim.blood.womersley import velocity_profile, womersley_number
from cathsim.contact.native import address, library
from cathsim.guidewire import LINK_NAME
from cathsim.planning.sampling import SamplingExpert
from tests.cathsim.makers import MakeEnv, MakeSimulation

SYSTOLE = 0.12  # s
PULSATILE, STEADY = FLOWS["pulsatile"], FLOWS["steady"]
REST = BloodFlow(peak_velocity=0.0)


def through(field: BloodField, branch: str, arc: float, time: float = SYSTOLE) -> float:
    """Flow (m^3/s) across the section of a branch, by a sum over rings that knows nothing of profiles."""
    vessel = field.phantom.tree[branch]
    centre, along, radius = vessel.point_at(arc), vessel.tangent_at(arc), float(vessel.radius_at(arc))
    first = np.cross(along, [0.31, 0.87, 0.4])
    first /= np.linalg.norm(first)
    rings, turn = (np.arange(80) + 0.5) / 80 * radius, np.arange(48) * 2 * np.pi / 48
    r, angle = (grid[..., None] for grid in np.meshgrid(rings, turn, indexing="ij"))
    points = centre + r * (np.cos(angle) * first + np.sin(angle) * np.cross(along, first))
    speed = field.velocity(points, time) @ along
    return float((speed * r[..., 0]).sum() * (radius / 80) * (2 * np.pi / 48))


@pytest.fixture
def pulsatile(type_1: Phantom) -> BloodField:
    return blood_field(type_1, PULSATILE)


@pytest.mark.parametrize(("branch", "share"), [("aorta", 0.2), ("lcca", 0.7)])
def test_poiseuille_carries_mean_velocity_times_area(type_1: Phantom, branch: str, share: float) -> None:
    field, vessel = blood_field(type_1, STEADY), type_1.tree[branch]
    arc = share * vessel.length
    radius = float(vessel.radius_at(arc))
    middle = np.linalg.norm(field.velocity(vessel.point_at(arc)))
    assert abs(through(field, branch, arc)) == pytest.approx(middle / 2 * math.pi * radius**2, rel=0.02)
    side = np.cross(vessel.tangent_at(arc), [0, 1, 0])
    side /= np.linalg.norm(side)
    halfway = np.linalg.norm(field.velocity(vessel.point_at(arc) + 0.5 * radius * side))
    assert halfway == pytest.approx(0.75 * middle, rel=0.02)


@pytest.mark.parametrize("time", [SYSTOLE, 0.45])
def test_mass_is_conserved_at_every_branching(pulsatile: BloodField, time: float) -> None:
    tree = pulsatile.phantom.tree
    root, bca = tree.root, tree["bca"]
    peak = pulsatile.peak_flow
    arch = {name: through(pulsatile, name, 0.75 * tree[name].length, time) for name in ("bca", "lcca", "lsa")}
    ascending = -through(pulsatile, "aorta", root.length - 0.01, time)
    descending = -through(pulsatile, "aorta", 0.15 * root.length, time)
    assert ascending == pytest.approx(float(pulsatile.flow_rate(time)), abs=0.02 * abs(ascending) + 1e-3 * peak)
    assert ascending == pytest.approx(descending + sum(arch.values()), abs=0.02 * abs(ascending) + 1e-3 * peak)
    fork = sum(through(pulsatile, name, 0.6 * tree[name].length, time) for name in ("rsa", "rcca"))
    assert through(pulsatile, "bca", 0.7 * bca.length, time) == pytest.approx(fork, abs=0.02 * abs(fork) + 1e-4 * peak)


def test_shares_follow_murray_and_what_is_given(type_1: Phantom) -> None:
    shares = outlet_shares(type_1.tree)
    assert sum(shares.values()) == pytest.approx(1.0)
    ends = type_1.tree["lsa"].radius[-1], type_1.tree["rcca"].radius[-1]
    assert shares["lsa"] / shares["rcca"] == pytest.approx((ends[0] / ends[1]) ** 3)
    given = blood_field(type_1, BloodFlow(descending_share=0.6, shares={"lcca": 0.25})).shares
    assert given["aorta"] == 0.6
    assert given["lcca"] == 0.25
    assert sum(given.values()) == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"blood cannot leave through bca; the open ends are .*lcca"):
        outlet_shares(type_1.tree, {"bca": 0.2})
    with pytest.raises(ValueError, match="must sum to 1, got 0"):
        outlet_shares(type_1.tree, dict.fromkeys(shares, 0.1))


def test_both_iliac_arteries_carry_what_the_descending_aorta_does() -> None:
    tree = build_random_tree(RandomTree(5))
    (other,) = (branch for branch in tree if branch.name.startswith("iliac"))
    cubes = np.array([tree.root.radius[0], other.radius[-1]]) ** 3
    shares = descending_shares(tree, 0.7, {})
    assert np.allclose([shares["aorta"], shares[other.name]], 0.7 * cubes / cubes.sum())
    assert descending_shares(tree, 0.7, {other.name: 0.2}) == pytest.approx({"aorta": 0.5})


def test_peak_velocity_is_that_of_the_root_over_the_beat(pulsatile: BloodField) -> None:
    root = pulsatile.phantom.tree.root
    times = np.arange(96) / 96 / PULSATILE.heart_rate
    side = np.cross(root.tangents[-1], [0, 1, 0])
    points = root.point_at(root.length - 0.004) + np.linspace(0, 0.9, 30)[:, None] * root.radius[-1] * side
    fastest = max(np.linalg.norm(pulsatile.velocity(points, time), axis=1).max() for time in times)
    assert fastest == pytest.approx(PULSATILE.peak_velocity, rel=0.03)
    assert 4.0 < pulsatile.cardiac_output * 6e4 < 8.0  # L/min: a resting adult's


def test_small_womersley_number_gives_poiseuille_and_a_large_one_a_blunt_profile() -> None:
    square = np.linspace(0.0, 1.0, 2001)
    assert np.abs(velocity_profile(0.05, square) - 2 * (1 - square)).max() < 1e-3
    assert np.array_equal(velocity_profile(0.0, square), 2 * (1 - square))
    for alpha in (1.0, 8.0, 30.0, 2000.0):
        assert np.trapezoid(velocity_profile(alpha, square), square) == pytest.approx(1.0, abs=0.03)
    blunt = velocity_profile(30.0, square)
    core = square < 0.6
    assert np.abs(blunt[core] - blunt[0]).max() < 0.02  # a plug ...
    assert abs(blunt[0]) < 1.1  # ... that moves with about the mean velocity
    assert womersley_number(0.012, 1.2) == pytest.approx(0.012 * math.sqrt(2 * math.pi * 1.2 * 1060 / 0.004))
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        velocity_profile(-1.0, square)


def test_drag_across_and_along_a_cylinder(type_1: Phantom) -> None:
    wire, density, viscosity = load_guidewire("default"), 1060.0, 0.004
    drag, d, slender = Drag(blood_field(type_1, PULSATILE), wire), wire.diameter, math.log(wire.length / wire.radius)
    for speed in (1e-4, 0.02, 0.5, 2.0):
        reynolds = density * speed * d / viscosity
        across = 4 * math.pi * viscosity / (slender + 0.193) * speed
        across += 0.5 * density * d * speed**2 * (1 + 4 / math.sqrt(reynolds))
        assert drag.force([0, speed, 0], [0, 0, 1.0]) == pytest.approx([0, across, 0], rel=1e-9)
        along = 2 * math.pi * viscosity / (slender - 0.807) * speed
        assert drag.force([0, 0, -speed], [0, 0, 1.0]) == pytest.approx([0, 0, -along], rel=1e-9)
    # oblique: Taylor's tangential force with the sine of the angle
    u, angle = 0.6, math.radians(30)
    force = drag.force([u * math.sin(angle), 0, u * math.cos(angle)], [0, 0, 1.0])
    reynolds = density * u * d / viscosity
    layer = 0.5 * density * d * u**2 * 5.4 / math.sqrt(reynolds) * math.cos(angle) * math.sqrt(math.sin(angle))
    slow = 2 * math.pi * viscosity / (slender - 0.807) * u * math.cos(angle)
    assert force[2] == pytest.approx(layer + slow, rel=1e-9)
    with pytest.raises(ValueError, match=r"shape \(3,\), got \(2,\)"):
        drag.force([1.0, 0.0], [0, 0, 1.0])


def moving(simulation: Simulation, steps: int = 45) -> Simulation:
    for _ in range(steps):
        simulation.advance(0.002, 0.1)
    return simulation


def apply_drag(simulation: Simulation) -> np.ndarray:
    """Computes the drag for the present state, on all links as if there were no sheath; the joint forces."""
    model, data, chain = simulation.model, simulation.data, simulation._chain
    mujoco.mj_forward(model, data)
    data.qfrc_applied[:] = 0.0
    pointers = [ctypes.c_void_p(at) for at in (chain.struct.drag, model._address, data._address)]
    library().blood_drag(*pointers, chain.struct.first_geom, chain.struct.last_geom, None, address(chain.loads))
    return data.qfrc_applied.copy()


def test_blood_at_rest_resists_the_motion_of_each_link(make_simulation: MakeSimulation) -> None:
    simulation = moving(make_simulation(blood=REST))
    model, data = simulation.model, simulation.data
    applied = apply_drag(simulation)
    power = 0.0
    first = model.geom(LINK_NAME.format(0)).id
    for index, load in enumerate(simulation._chain.loads):
        geom = first + index
        length = 2 * model.geom_size[geom, 1]
        if length > 0.008 + 1e-9:
            continue  # cut into parts
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, velocity, 0)
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        assert load[:3] == pytest.approx(length * simulation.drag.force(-velocity[3:], axis), rel=1e-6, abs=1e-12)
        power += load[:3] @ velocity[3:]
    assert power < 0
    assert applied @ data.qvel < 0
    still = make_simulation(blood=REST)
    for _ in range(20):
        still.advance(0.0, 0.0)
    assert np.abs(still.blood_forces()).max() < 1e-6


def test_wire_is_pushed_downstream_and_the_sheath_shields_it(make_simulation: MakeSimulation) -> None:
    simulation = moving(make_simulation("nitrex_straight", blood=BloodFlow(waveform="steady")), 40)
    for _ in range(10):
        simulation.advance(0.0, 0.0)
    forces = simulation.blood_forces()
    assert forces[:5, 2].sum() < 0  # in the descending aorta, where the blood comes from above
    points = simulation.inserted_points()
    middles = (points[1:] + points[:-1]) / 2 - simulation.vessel.entry
    inside = middles @ simulation.vessel.direction < -0.008
    assert inside.any()
    assert np.abs(forces[inside]).max() == 0.0
    lengths = np.array(simulation.wire.links[::-1][: len(forces)])
    assert np.linalg.norm(forces, axis=1).sum() < 1.0 * lengths.sum()  # below Taylor's at 1 m/s across, about 0.6 N/m


def test_environment_takes_a_name_a_flow_or_none_and_the_expert_plans_with_it(make_env: MakeEnv) -> None:
    env = make_env(blood="pulsatile", observation="tip")
    env.reset(seed=0)
    expert = SamplingExpert(env, seed=0, threads=1)
    assert [copy.blood for copy in expert.trials._copies] == [PULSATILE]
    expert.close()
    steps = []
    for blood in (None, "steady", PULSATILE, "pulsatile"):
        env = make_env(blood=blood, observation="tip")
        env.reset(seed=0)
        for _ in range(40):
            observation, *_ = env.step(np.array([1.0, 0.3]))
        steps.append(observation)
    assert np.array_equal(steps[2], steps[3])
    assert not np.array_equal(steps[0], steps[1])
    with pytest.raises(ValueError, match="unknown blood 'thick'; there are steady, pulsatile"):
        make_env(blood="thick")


def test_picture_is_drawn(type_1: Phantom, tmp_path: Path) -> None:
    picture(type_1, tmp_path / "blood.png", flow=STEADY)
    assert (tmp_path / "blood.png").read_bytes().startswith(b"\x89PNG")
