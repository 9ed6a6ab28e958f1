"""A wire in a vessel: state and restore, the active chain against the whole wire, refinement, forces, feeding."""

import dataclasses

import mujoco
import numpy as np
import pytest

from cathsim import ACCURACY, Guidewire, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.devices.active_chain import ActiveChains
from cathsim.devices.arena import max_insertion
from tests.cathsim.makers import MakeSimulation

STEP = 0.002  # m
LEAVING = 5  # steps until the tip is free of the sheath


def random_actions(count: int, seed: int) -> np.ndarray:
    """Mostly forwards, with rotation: translations (m) and rotations (rad), shape (count, 2)."""
    generator = np.random.default_rng(seed)
    return np.column_stack((generator.uniform(-0.2, 1.0, count) * STEP, generator.uniform(-0.26, 0.26, count)))


def run(simulation: Simulation, actions: np.ndarray) -> np.ndarray:
    """Tips and forces, shape (steps, 6)."""
    rows = []
    for translation, rotation in actions.tolist():
        simulation.advance(translation, rotation)
        rows.append(np.concatenate((simulation.tip, simulation.force())))
    return np.array(rows)


def straight(count: int) -> np.ndarray:
    return np.tile([STEP, 0.0], (count, 1))


@pytest.fixture
def whole_wire(monkeypatch: pytest.MonkeyPatch, make_simulation: MakeSimulation) -> MakeSimulation:
    """Makes simulations in which all links are simulated all the time."""

    def single(wire: Guidewire) -> ActiveChains:
        return ActiveChains((len(wire.links),), (max_insertion(wire),))

    def make(*args: object, **kwargs: object) -> Simulation:
        with monkeypatch.context() as patch:
            patch.setattr(ActiveChains, "of", staticmethod(single))
            return make_simulation(*args, **kwargs)

    return make


def test_reset_puts_the_tip_just_inside_the_vessel(make_simulation: MakeSimulation, type_1: Phantom) -> None:
    simulation = make_simulation("nitrex_straight")
    gate = type_1.entries["descending"]
    assert simulation.tip == pytest.approx(gate.position + 0.005 * gate.direction, abs=2e-4)
    simulation.reset(insertion=0.05)
    assert simulation.insertion == pytest.approx(0.05, abs=1e-4)
    with pytest.raises(ValueError, match=r"insertion must lie in 0 to 0\.231 m, got 1"):
        simulation.reset(insertion=1)


@pytest.mark.parametrize("warm_up", [0, 47])
def test_a_restored_state_goes_on_with_the_same_bits(make_simulation: MakeSimulation, warm_up: int) -> None:
    one, other = make_simulation(), make_simulation()
    run(one, random_actions(warm_up, seed=1))
    state = one.state()
    chains = set()
    run(other, random_actions(70, seed=2))  # somewhere else, on another chain
    other.restore(state)
    assert np.array_equal(other.state(), state)
    for translation, rotation in random_actions(40, seed=3).tolist():  # across chains
        one.advance(translation, rotation)
        other.advance(translation, rotation)
        chains.add(one.active_links)
        assert np.array_equal(one.state(), other.state())
        assert np.array_equal(one.force(), other.force())
        assert np.array_equal(one.tip, other.tip)
    assert len(chains) > 1, "the test is to cross chains"


def test_a_state_of_another_wire_is_refused(make_simulation: MakeSimulation) -> None:
    with pytest.raises(ValueError, match=r"expected a state of shape \(173,\), got \(509,\)"):
        make_simulation().restore(make_simulation("thesis").state())
    state = make_simulation().state()
    for place, value in ((0, np.nan), (-1, np.nan), (-1, 1e6), (-1, 0.5), (-1, -1.0)):
        wrong = state.copy()
        wrong[place] = value
        with pytest.raises(ValueError, match="no state of this simulation"):
            make_simulation().restore(wrong)


@pytest.mark.parametrize("wire", ["default", "thesis"])
def test_a_chain_agrees_with_the_whole_wire(
    make_simulation: MakeSimulation, whole_wire: MakeSimulation, wire: str
) -> None:
    active, whole = make_simulation(wire), whole_wire(wire)
    assert whole.active_links == len(whole.wire.links) > active.active_links
    apart = np.linalg.norm((run(active, straight(60)) - run(whole, straight(60)))[:, :3], axis=1)
    # the bent tip springs out of the sheath in the first steps, in one model a little before the other
    assert apart[:LEAVING].max() < 4e-3
    assert apart[LEAVING:].max() < 1e-3
    assert whole.active_links == len(whole.wire.links) > active.active_links
    active.reset()
    whole.reset()
    turning = random_actions(60, seed=0)
    apart = np.linalg.norm((run(active, turning) - run(whole, turning))[:, :3], axis=1)
    assert apart[LEAVING:].max() < 3e-3


def test_a_change_of_rung_moves_nothing(make_simulation: MakeSimulation, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = make_simulation()
    jumps = []
    change = simulation._change_chain

    def watched(index: int) -> None:
        before, depth = simulation.inserted_points(), simulation.state()[-2]
        change(index)
        assert simulation.state()[-2] == depth, "the penetration decides on the next substep"
        mujoco.mj_kinematics(simulation.model, simulation.data)
        after = simulation.inserted_points()
        shared = min(len(before), len(after))
        jumps.append(np.linalg.norm(after[:shared] - before[:shared], axis=1).max())

    monkeypatch.setattr(simulation, "_change_chain", watched)
    turning = random_actions(90, seed=4)
    turning[:, 0] = STEP
    run(simulation, turning)
    run(simulation, turning * [-1.0, 1.0])
    assert len(jumps) > 16
    assert max(jumps) < 3e-4


@pytest.mark.parametrize("accuracy", ["fast", "accurate"])
def test_refinement_keeps_the_wire_out_of_the_wall(make_simulation: MakeSimulation, accuracy: str) -> None:
    generator = np.random.default_rng(1)
    numerics = ACCURACY[accuracy]
    never = dataclasses.replace(numerics, refinement=1)
    simulations = [make_simulation(numerics=n, measure_penetration=True) for n in (numerics, never)]
    deepest = np.zeros((2, 150))
    repeated = 0
    for simulation in simulations:
        simulation.reset(insertion=0.1)
    for step in range(150):
        if step % 25 == 0:
            direction = np.sign(generator.uniform(-0.5, 1.0)) * STEP, np.sign(generator.uniform(-1, 1)) * 0.26
        for index, simulation in enumerate(simulations):
            simulation.advance(*direction)
            deepest[index, step] = simulation.depths.max()
            assert simulation.summary.penetration_max == deepest[index, step]
            assert simulation.valid
        repeated += simulations[0].summary.refined
        assert simulations[1].summary.refined == 0
    assert repeated > 0
    refined, coarse = deepest.max(axis=1)
    assert refined < 1.5e-3
    assert refined < 0.6 * coarse


def test_force_is_the_sum_of_contacts_and_means_balance_the_feeder(make_simulation: MakeSimulation) -> None:
    simulation = make_simulation()
    for translation, rotation in random_actions(60, seed=6).tolist():
        simulation.advance(translation, rotation)
        contacts, summary = simulation.contacts(), simulation.summary
        assert simulation.force() == pytest.approx(contacts.forces.sum(axis=0), abs=1e-12)
        assert np.linalg.norm(simulation.force()) == pytest.approx(summary.force_max, abs=1e-12)
        assert np.linalg.norm(summary.mean_force) <= summary.force_mean + 1e-12, "a mean's norm, a norm's mean"
        assert summary.force_mean <= summary.magnitude_sum + 1e-12, "triangle inequality"
        assert summary.contact_max >= np.linalg.norm(contacts.forces, axis=1).max(initial=0.0)
    run(simulation, straight(40))
    run(simulation, np.zeros((40, 2)))
    force, contacts, summary = simulation.force(), simulation.contacts(), simulation.summary
    along = simulation.vessel.direction
    assert np.abs(simulation.data.qvel[:2]).max() < 1e-4, "at rest"
    assert np.linalg.norm(force) > 0.02
    # the sheath is frictionless, so along its axis the feeder's servo alone balances the wall
    assert force @ along == pytest.approx(-simulation.data.actuator_force[0], rel=0.02)
    distances, inward = simulation.vessel.distance(contacts.points)
    assert np.abs(distances).max() < 1e-3, "contacts lie on the wall"
    assert ((contacts.forces * inward).sum(axis=1) > 0).all(), "the wall pushes the wire inwards"
    magnitudes = np.linalg.norm(contacts.forces, axis=1)
    assert np.array(summary.mean_force) == pytest.approx(force, rel=0.02, abs=1e-4)
    assert summary.magnitude_sum == pytest.approx(magnitudes.sum(), rel=0.02)
    assert summary.contact_max == pytest.approx(magnitudes.max(), rel=0.02)
    # wall and sheath hold the wire against the feeder, which pushes along its axis and guides across
    sheath = np.array(summary.sheath_force)
    assert abs(sheath @ along) < 1e-3 * max(np.linalg.norm(sheath), 1e-3), "the sheath is frictionless"
    assert np.linalg.norm(sheath) > 1e-3


def test_motors_bend_the_tip(make_simulation: MakeSimulation) -> None:
    simulation = make_simulation("nitrex_straight", tip_motors=True)
    simulation.reset(insertion=0.03)
    start = simulation.tip
    share = np.zeros(simulation.motors)
    share[0::2] = 1.0
    for _ in range(10):
        simulation.advance(0.0, 0.0, share)
    assert np.linalg.norm(simulation.tip - start) > 5e-3


def test_movements_that_are_not_finite_are_refused(make_simulation: MakeSimulation) -> None:
    simulation = make_simulation(tip_motors=True)
    for movement in ((np.nan, 0.0), (0.0, np.inf)):
        with pytest.raises(ValueError, match=r"rotation .rad. must be finite numbers"):
            simulation.advance(*movement)
    with pytest.raises(ValueError, match="the motors' shares must be finite"):
        simulation.advance(0.0, 0.0, np.full(simulation.motors, np.nan))
    assert simulation.valid


# tips (mm) after 20, 40 and 60 steps, as of the version from before catheters, whose contacts MuJoCo's solver solved
AS_BEFORE = {
    ("type_1", "accurate"): (
        (57.17277, 22.36953, -78.60765),
        (46.57543, 35.98984, -51.78142),
        (32.62671, 24.25499, -23.69427),
    ),
    ("type_2", "fast"): (
        (63.20126, 20.22351, -78.37497),
        (51.87593, 31.52878, -50.56302),
        (37.96811, 21.44204, -23.54347),
    ),
}


@pytest.mark.parametrize(("phantom", "preset"), AS_BEFORE)
def test_the_bare_wire_moves_as_it_did(phantom: str, preset: str) -> None:
    simulation = Simulation(load_phantom(phantom), load_guidewire("default"), ACCURACY[preset])
    simulation.reset()
    tips = []
    for step in range(60):
        simulation.advance(STEP if step % 9 < 7 else -0.5 * STEP, 0.3 if step % 7 < 3 else -0.1)
        tips.append(1e3 * simulation.tip)
    # between the two solvers lie 0.003 mm; 1 % of stiffness, density or diameter or 2 % of friction move a tip by 0.08
    assert np.allclose(tips[19::20], AS_BEFORE[phantom, preset], rtol=0.0, atol=0.02)


def test_joint_positions_set_are_those_of_a_wire_that_is_held(make_simulation: MakeSimulation) -> None:
    driven, other = make_simulation(), make_simulation()
    run(driven, random_actions(60, 3))
    other.set_joint_positions(driven.joint_positions())
    np.testing.assert_allclose(other.joint_positions(), driven.joint_positions(), atol=1e-12)
    np.testing.assert_allclose(other.wire_points(), driven.wire_points(), atol=1e-9)
    assert not other.joint_velocities().any()
    assert not other.lead().any()
    other.advance(0.0, 0.0)
    assert other.insertion == pytest.approx(driven.insertion, abs=1e-3)
    with pytest.raises(ValueError, match="joint positions must have shape"):
        other.set_joint_positions(np.zeros(3))
    with pytest.raises(ValueError, match="insertion must lie in 0 to"):
        other.set_joint_positions(driven.joint_positions() + 1.0)
