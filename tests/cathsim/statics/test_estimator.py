"""Forces from observed curves: the estimate, its spread, laying, summaries."""

from typing import NamedTuple

import numpy as np
import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.centreline import arc_length, resampled
from cathsim.anatomy.library import load_phantom
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation
from cathsim.statics import ContactForceEstimator, contact_forces, curve_from_entry, inserted_curve
from cathsim.statics.ensemble_summary import RestingContacts, resting_contacts, summarise
from cathsim.statics.observed_curve import observed_curve
from cathsim.statics.uncertainty import Deviation, Uncertainty, deviations, smooth_noise


class Resting(NamedTuple):
    """A simulated wire at rest, and what an estimate of its contacts is to find."""

    phantom: Phantom
    wire: Guidewire
    simulation: Simulation
    curve: np.ndarray
    truth: RestingContacts


@pytest.fixture(scope="module")
def resting() -> Resting:
    phantom, wire = load_phantom("type_1"), Guidewire()
    simulation = Simulation(phantom, wire, ACCURACY["accurate"])
    simulation.reset(0.0, 0.7)
    for _ in range(105):
        simulation.advance(0.002, 0.02)
    for _ in range(20):
        simulation.advance(0.0, 0.0)
    curve = inserted_curve(simulation)
    observed = observed_curve(curve, phantom, "descending", simulation.max_insertion)
    return Resting(phantom, wire, simulation, curve, resting_contacts(simulation, observed))


def resultant(truth: RestingContacts) -> float:
    return float(np.linalg.norm(truth.resultant))


@pytest.fixture(scope="module")
def feeder(resting) -> tuple[float, float]:
    return resting.simulation.insertion, resting.simulation.rotation


def test_the_exact_curve_gives_the_forces(resting, feeder) -> None:
    assert resting.truth.normal_sum > 0.05
    found = contact_forces(resting.curve, resting.phantom, resting.wire, *feeder, members=1)
    assert found.normal_sum.value == pytest.approx(resting.truth.normal_sum, rel=0.1)
    assert found.resultant.value == pytest.approx(resultant(resting.truth), rel=0.1)
    assert found.largest.value == pytest.approx(resting.truth.largest, rel=0.15)
    assert np.linalg.norm(found.resultant_vector - resting.truth.resultant) < 0.15 * resultant(resting.truth)
    assert found.normal_sum.low == found.normal_sum.high == pytest.approx(found.normal_sum.value)
    assert found.shape_error < 1e-3
    assert found.members == 1


def test_an_ensemble_holds_the_truth_and_is_repeatable(resting, feeder) -> None:
    points = resampled(resting.curve, 1e-3)
    noisy = points + 0.5e-3 * smooth_noise(len(points), 1e-3, 0.010, np.random.default_rng(3))
    arguments = (noisy, resting.phantom, resting.wire, *feeder)
    found, again = (contact_forces(*arguments, members=6, seed=1, workers=workers) for workers in (1, 2))
    assert found.members == 6
    for name, true in (("normal_sum", resting.truth.normal_sum), ("resultant", resultant(resting.truth))):
        estimate = getattr(found, name)
        assert estimate.low < estimate.value < estimate.high
        assert estimate.low < true < estimate.high
        assert estimate.value == pytest.approx(true, rel=0.5)
        assert estimate == getattr(again, name)
    count = len(found.points)
    assert found.forces.shape == (count, 3)
    assert found.normal_forces_90.shape == found.from_tip_90.shape == (count, 2)
    assert (found.normal_forces_90[:, 0] <= found.normal_forces).all()
    assert (found.normal_forces <= found.normal_forces_90[:, 1]).all()
    assert (np.diff(found.from_tip) >= 0).all()
    assert ((found.presence > 0) & (found.presence <= 1)).all()
    np.testing.assert_allclose(found.forces.sum(axis=0), found.resultant_vector)


def test_without_feeder_data_both_are_found_and_frames_go_on_from_the_last_rotation(resting, feeder) -> None:
    tracker = ContactForceEstimator(resting.phantom, resting.wire, members=1)
    found = tracker.update(resting.curve)
    assert found.insertion == pytest.approx(feeder[0], abs=2e-3)
    assert np.cos(found.rotation - feeder[1]) > np.cos(1.2)  # the wall holds this tip
    assert found.normal_sum.value == pytest.approx(resting.truth.normal_sum, rel=0.4)
    assert abs(tracker.update(resting.curve).rotation - found.rotation) < 0.2
    tracker.reset()
    assert tracker.update(resting.curve).rotation == pytest.approx(found.rotation)


def test_a_sequence_follows_the_wire(resting, feeder) -> None:
    simulation = resting.simulation
    state = simulation.state()
    tracker = ContactForceEstimator(resting.phantom, resting.wire, friction=resting.wire.friction)
    tracker.update(resting.curve, *feeder)
    for _ in range(8):
        simulation.advance(0.001, 0.05)
        found = tracker.update(inserted_curve(simulation), simulation.insertion, simulation.rotation)
    true = np.linalg.norm(simulation.contacts().forces.sum(axis=0))
    simulation.restore(state)
    assert found.resultant.value == pytest.approx(true, rel=0.25)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda curve: curve[:, :2], r"shape \(n, 3\)"),
        (lambda curve: curve[:1], "2 points at least"),
        (lambda curve: "curve", "must be numbers"),
        (lambda curve: np.where(np.arange(len(curve))[:, None] == 5, np.nan, curve), "must be finite, its point 5"),
        (lambda curve: np.repeat(curve[:1], 4, axis=0), "4 points of this one lie in one place"),
        (lambda curve: curve[::-1], "reverse it"),
        (lambda curve: 1e3 * curve, "give it in m"),
        (lambda curve: np.vstack((curve, curve[-1] + [0.05, 0.0, 0.0])), "outside of it"),
        (lambda curve: np.vstack((curve, curve[::-1][:-5], curve[5:])), "give a longer device"),
    ],
)
def test_a_curve_that_cannot_be_is_refused(resting, change, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        contact_forces(change(resting.curve), resting.phantom, resting.wire, members=1)


@pytest.mark.parametrize(
    ("feeder", "message"),
    [
        ((-0.1, 0.0), "insertion must lie in 0 to"),
        ((0.1, 0.0), "does not fit a curve of"),
        ((None, np.inf), "rotation must be a finite number"),
        (([0.1, 0.2], 0.0), r"insertion must be a number \(m\), got \[0.1, 0.2\]"),
        ((None, "left"), r"rotation must be a number \(rad\), got 'left'"),
    ],
)
def test_a_feeder_that_cannot_be_is_refused(resting, feeder, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        contact_forces(resting.curve, resting.phantom, resting.wire, *feeder, members=1)


@pytest.fixture(scope="module")
def pair() -> tuple[DevicePair, DualSimulation]:
    devices = DevicePair(Guidewire(), load_catheter("vertebral_5f"))
    simulation = DualSimulation(load_phantom("type_1"), devices, ACCURACY["accurate"])
    simulation.reset(0.03, 0.0, catheter=(0.0, 0.5))
    for _ in range(80):
        simulation.advance(0.002, 0.0, catheter=(0.002, 0.02))
    for _ in range(20):
        simulation.advance(0.0, 0.0)
    return devices, simulation


def test_a_wire_in_a_catheter_is_laid_too(pair) -> None:
    devices, simulation = pair
    phantom, curve = simulation.phantom, inserted_curve(simulation)
    (wire, catheter), (first, second) = simulation.device_insertions(), simulation.device_rotations()
    observed = observed_curve(curve, phantom, "descending", simulation.max_insertion)
    truth = resting_contacts(simulation, observed)
    assert truth.normal_sum > 0.05
    found = contact_forces(curve, phantom, devices, wire, first, catheter=(catheter, second), members=1)
    assert found.normal_sum.value == pytest.approx(truth.normal_sum, rel=0.3)
    assert found.shape_error < 2e-3
    with pytest.raises(ValueError, match="needs the feeders' positions"):
        contact_forces(curve, phantom, devices, members=1)
    with pytest.raises(ValueError, match="catheter's insertion must lie in"):
        contact_forces(curve, phantom, devices, wire, first, catheter=(9.0, second), members=1)


def test_other_arguments_that_cannot_be_are_refused(resting) -> None:
    for wrong, said in (
        ({"entry": "femoral"}, "unknown entry 'femoral'"),
        ({"device": "default"}, "device must be"),
        ({"accuracy": "exact"}, "unknown accuracy"),
        ({"phantom": "type_1"}, "phantom must be"),
        ({"members": 2.5}, "members must be a whole number, got 2.5"),
        ({"members": 0}, "must be 1 at least"),
    ):
        with pytest.raises(ValueError, match=said):
            contact_forces(resting.curve, **{"phantom": resting.phantom, "device": resting.wire, **wrong})


def member(*contacts: tuple[float, float, float]) -> RestingContacts:
    """Contacts, each a distance from the tip (m), a normal force (N) and a side (1 or -1)."""
    at, normal, side = (np.array(column, float) for column in zip(*contacts, strict=True))
    points = np.stack([at, 0 * at, 0 * at], axis=1)
    return RestingContacts(points, np.stack([0 * at, side * normal, 0 * at], axis=1), normal, at, 0.0)


def test_contacts_are_matched_by_place_and_side() -> None:
    other_side, elsewhere = member((0.1, 1.0, -1.0)), member((0.15, 1.0, 1.0))
    shown = member((0.1, 1.0, 1.0))
    found = summarise([shown, member((0.105, 1.0, 1.0)), other_side, elsewhere], 0.0, 0.0)
    assert found.presence == pytest.approx([0.5])
    assert 0.1 <= found.from_tip_90[0, 0] <= found.from_tip_90[0, 1] <= 0.105


@pytest.mark.parametrize("tip_first", [True, False])
def test_the_sheath_is_cut_off_whatever_the_order(resting, tip_first: bool) -> None:
    nodes = resting.simulation.wire_points()
    assert np.linalg.norm(nodes[-1] - resting.curve[0]) > 0.04  # the rest lies in the sheath
    curve = curve_from_entry(nodes if tip_first else nodes[::-1], resting.phantom)
    np.testing.assert_allclose(curve[-1], resting.curve[-1])
    assert arc_length(curve)[-1] == pytest.approx(arc_length(resting.curve)[-1], abs=1e-3)
    found, wanted = (observed_curve(points, resting.phantom, "descending", 0.31) for points in (curve, resting.curve))
    assert found.length == pytest.approx(wanted.length, abs=5e-4)
    assert np.abs(found.at(np.linspace(0, 0.2, 50)) - wanted.at(np.linspace(0, 0.2, 50))).max() < 1e-3


def test_what_is_no_curve_to_the_entry_is_refused(resting) -> None:
    far = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 6.0]])
    for curve, said in ((far[:1], "2 points at least"), ("wire", "numbers of shape"), (far, "give the whole wire")):
        with pytest.raises(ValueError, match=said):
            curve_from_entry(curve, resting.phantom)
    with pytest.raises(ValueError, match="unknown entry"):
        curve_from_entry(resting.curve, resting.phantom, "nowhere")


def test_members_spread_as_asked() -> None:
    sizes = Uncertainty(stiffness=0.2, insertion=2e-3, rotation=0.1, registration=1e-3, lumen=3e-4, friction=0.5)
    members = deviations(201, sizes, 4)
    assert members[0] == Deviation()
    rest = members[1:]
    assert np.std(np.log([one.stiffness for one in rest])) == pytest.approx(0.2, rel=0.05)
    assert np.std([one.insertion for one in rest]) == pytest.approx(2e-3, rel=0.05)
    assert np.std([one.rotation for one in rest]) == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(np.std([one.shift for one in rest], axis=0), 1e-3, rtol=0.05)
    assert np.std([one.lumen for one in rest]) == pytest.approx(3e-4, rel=0.05)
    assert len({one.lumen for one in rest}) == 4
    assert np.std(np.log([one.friction for one in rest])) == pytest.approx(0.5, rel=0.05)
