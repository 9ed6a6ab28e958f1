"""Metrics of episodes, forces and load cells, by hand."""

import json

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import Phantom
from cathsim.blood.flow import FLOWS, BloodFlow
from cathsim.guidewire import Guidewire
from cathsim.metrics import EpisodeMetrics, force_magnitudes, path_length, spl, summarise
from cathsim.metrics.episodes import wilson_interval
from cathsim.metrics.forces import HEAT_WIDTH, ForceComparison, compare_forces, verdict, wall_heat
from cathsim.metrics.load_cell import MINI40, LoadCell, StepForces, step_forces
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation


def straight_episode(length, steps, *, success=True, force=0.5, target="bca"):
    tips = np.zeros((steps + 1, 3))
    tips[:, 2] = np.linspace(0, length, steps + 1)
    return EpisodeMetrics.from_arrays(tips, np.full(steps, force), np.full(steps, -0.1), success, target=target)


def test_spl_by_hand():
    # 0.2/0.2, 0.2/0.4, a failure, and a way shorter than the optimum, which counts as 1
    assert spl([True, True, False, True], [0.2, 0.4, 0.1, 0.15], 0.2) == pytest.approx((1 + 0.5 + 0 + 1) / 4)
    assert spl([True, True], [0.2, 0.3], [0.1, 0.3]) == pytest.approx(0.75)
    assert spl([False], [0.3], np.nan) == 0.0
    assert spl([True], [0.0], 0.0) == 1.0


def test_episode_metrics_by_hand():
    tips = np.array([[0, 0, 0], [0, 0, 0.003], [0, 0.004, 0.003]])
    episode = EpisodeMetrics.from_arrays(tips, [[0, 0, 1.0], [0, 3.0, 0]], [-1.0, 10.0], True, target="lcca")
    assert (episode.force_mean, episode.force_max, episode.steps) == (2.0, 3.0, 2)
    assert episode.force_p95 == pytest.approx(2.9)
    assert episode.path_length == pytest.approx(0.007)
    assert episode.safety == 0.5
    assert episode.reward == 9.0
    assert episode.success
    assert episode.target == "lcca"


def test_summary_has_the_units_and_the_spread_of_the_tables():
    episodes = [straight_episode(0.16, 40, force=1.0), straight_episode(0.20, 60, force=3.0)]
    episodes += [straight_episode(0.30, 300, success=False, force=2.0)]
    summary = summarise(episodes)
    assert summary.episodes == 3
    assert summary.force_n.mean == pytest.approx(2.0)
    assert summary.force_n.sd == pytest.approx(np.sqrt(2 / 3))
    assert summary.path_length_cm.mean == pytest.approx(22.0)
    assert summary.episode_length_steps.mean == pytest.approx(400 / 3)
    assert summary.safety_pct.mean == pytest.approx(100 / 3)
    assert summary.success_pct.mean == pytest.approx(200 / 3)
    assert summary.success_pct.sd == pytest.approx(100 * np.sqrt(2) / 3)
    assert summary.spl_pct == pytest.approx(100 * (1 + 0.8 + 0) / 3)
    assert summary.reward.mean == pytest.approx(-40 / 3)
    assert json.loads(json.dumps(summary.as_dict()))["path_length_cm"][0] == pytest.approx(22.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: summarise([]), "at least one episode"),
        (lambda: summarise([straight_episode(0.1, 5)], shortest={"lsa": 0.1}), "no optimal .*for target 'bca'"),
        (lambda: summarise([straight_episode(0.1, 5)], shortest=[0.1, 0.2]), "one optimal length for each of 1"),
        (lambda: spl([True], [0.1], np.nan), "finite optimal length"),
        (lambda: spl([], [], 0.1), "at least one episode"),
        (lambda: force_magnitudes([np.nan]), "finite and not negative"),
        (lambda: force_magnitudes(np.zeros((3, 2))), r"shape \(T,\) or \(T, 3\)"),
        (lambda: path_length(np.zeros((3, 2))), "shape"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((3, 3)), [0.1] * 3, [0.0] * 3, True), r"T \+ 1 tip positions"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((1, 3)), [], [], False), "T >= 1"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((2, 3)), [0.1], [np.inf], False), "rewards must be finite"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


REAL = {"real_mean_n": 0.40, "real_sd_n": 0.19}
PUSHED = np.array([0.02, 0.04])


@pytest.fixture
def drawn() -> np.ndarray:
    return np.random.default_rng(3).normal(0.40, 0.19, 400)


def comparison_of(forces: np.ndarray) -> ForceComparison:
    return compare_forces(forces, **REAL, generator=np.random.default_rng(0))


def words(forces: np.ndarray) -> tuple[str, str]:
    return verdict(comparison_of(forces), PUSHED, operators={"sampling_expert"}, free_force_n=0.15)


def test_forces_of_the_real_distribution_agree_with_it(drawn: np.ndarray) -> None:
    result = comparison_of(drawn)
    assert min(result.mann_whitney_p, result.levene_p, result.shapiro_p) > 0.05
    assert result.exceedance == pytest.approx(0.5, abs=0.05)
    assert result.u_statistic == pytest.approx(0.5 * 400**2, rel=0.1)
    assert words(drawn)[1] == "Nothing."


def test_each_test_finds_its_own_difference(drawn: np.ndarray) -> None:
    shifted, narrow = comparison_of(drawn + 0.1), comparison_of(0.40 + 0.5 * (drawn - drawn.mean()))
    skew = comparison_of(np.random.default_rng(1).exponential(0.4, 400))
    assert shifted.mann_whitney_p < 1e-6 < shifted.levene_p
    assert narrow.levene_p < 1e-6 < narrow.mann_whitney_p
    assert skew.shapiro_p < 1e-6 < shifted.shapiro_p
    assert shifted == comparison_of(drawn + 0.1)  # the draws are seeded


def test_verdict_names_size_and_side_of_the_difference_and_what_was_not_tested() -> None:
    small = np.abs(np.random.default_rng(2).normal(0.0, 0.05, 300))
    small[:90] = 0.0
    result = comparison_of(small)
    assert result.contact_share == pytest.approx(0.7)
    agrees, differs = words(small)
    assert f"below the real 0.40 N by a factor of {0.40 / result.mean_n:.1f}" in differs
    assert "30 % of the steps" in differs
    assert f"0.030 ± 0.010 N, {0.03 / result.mean_n:.1f} times as much" in differs
    assert "was not tested" in differs
    assert "100 % of the simulated forces" in agrees
    assert "never presses on the wall" in words(np.zeros(50))[1]


def test_heat_lies_where_the_contacts_are() -> None:
    wall = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    vertices = np.asarray(wall.vertices)
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.02, 0.0, 0.0]])
    largest, total = wall_heat(vertices, points, np.array([0.3, 0.1, 0.2]))
    top, side, back = (
        np.linalg.norm(vertices - place, axis=1).argmin() for place in (points[0], points[2], [0, 0.02, 0])
    )
    assert largest[[top, side, back]] == pytest.approx([0.3, 0.2, 0.0], rel=0.05)
    assert total[[top, side, back]] == pytest.approx([0.4, 0.2, 0.0], rel=0.05)
    away = np.linalg.norm(vertices - points[0], axis=1)
    beyond = (away > 3 * HEAT_WIDTH) & (np.linalg.norm(vertices - points[2], axis=1) > 3 * HEAT_WIDTH)
    assert largest[beyond].max() == 0.0
    assert np.array_equal(wall_heat(vertices, np.zeros((0, 3)), np.zeros(0))[0], np.zeros(len(vertices)))


def test_wilson_interval_is_the_textbook_one() -> None:
    assert wilson_interval(30, 30) == (pytest.approx(0.8865, abs=1e-4), 1.0)
    assert wilson_interval(0, 30) == (0.0, pytest.approx(0.1135, abs=1e-4))
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    with pytest.raises(ValueError, match="got 3 of 2"):
        wilson_interval(3, 2)


@pytest.mark.parametrize("blood", [None, FLOWS["steady"]])
def test_load_along_the_sheath_is_the_feeders_push(type_1: Phantom, blood: BloodFlow | None) -> None:
    simulation = Simulation(type_1, Guidewire(), ACCURACY["accurate"], blood=blood)
    for _ in range(90):
        simulation.advance(0.002, 0.02)
    for _ in range(60):
        simulation.advance(0.0, 0.0)
    forces, along = step_forces(simulation), simulation.vessel.direction
    push = float(simulation.data.actuator_force[0])
    assert abs(push) > 0.005
    # the sheath has no friction: what the feeder pushes with, the vessel gets, with the blood's drag on the wire
    assert forces.load @ along == pytest.approx(push, rel=0.03, abs=2e-4)
    if blood is not None:
        drag = simulation.blood_forces().sum(axis=0)
        assert np.linalg.norm(drag) > 1e-4
        assert forces.load == pytest.approx(-np.array(simulation.summary.mean_force) - drag, abs=1e-12)


def test_a_cell_bears_the_sheath_where_it_is_mounted_on_the_same_plate() -> None:
    forces = StepForces(
        load=np.array([1.0, 2.0, 3.0]), sheath=np.array([0.0, -5.0, 1.0]), magnitude_sum=9.0, largest_contact=5.0
    )
    assert LoadCell().load(forces).tolist() == [1.0, 2.0, 3.0]
    assert LoadCell(bears_sheath=True).load(forces).tolist() == [1.0, -3.0, 4.0]


def test_a_step_of_load_rises_as_a_filter_of_first_order() -> None:
    loads = np.concatenate((np.zeros((1, 3)), np.ones((9, 3))))
    cell = LoadCell(resolution=(0.0, 0.0, 0.0), cutoff=0.5)
    readings = cell.read(loads, interval=0.1, generator=np.random.default_rng(0))
    time = 0.1 * np.arange(10)
    assert readings[:, 0] == pytest.approx(1 - np.exp(-2 * np.pi * 0.5 * time))


@pytest.mark.parametrize("name", sorted(MINI40))
def test_noise_and_rounding_are_those_of_the_calibration(name: str) -> None:
    cell = MINI40[name]
    readings = cell.read(np.zeros((4000, 3)), interval=0.1, generator=np.random.default_rng(0))
    steps = np.array(cell.resolution)
    assert readings / steps == pytest.approx((readings / steps).round(), abs=1e-9)
    assert readings.std(axis=0) == pytest.approx(steps * np.sqrt(1 + 1 / 12), rel=0.05)
