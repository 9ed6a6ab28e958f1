"""Rehearsal: copies of a scan within its uncertainty, walls that move, the environment of them."""

import dataclasses

import numpy as np
import pytest

from cathsim import NavigateEnv, Phantom, load_guidewire
from cathsim.rehearsal.environment import NavigateCopiesEnv, Perturbation, copy_of
from cathsim.rehearsal.walls import displaced_walls
from tests.cathsim.anatomy.wall.tubes import tubes, wall_at


def made(type_1: Phantom, **arguments: object) -> NavigateCopiesEnv:
    settings = {"accuracy": "fast", "observation": ("roadmap", "history"), "reward": "geodesic"} | arguments
    return NavigateCopiesEnv(type_1, ("bca", "lcca"), copies=(0, 1, 2), **settings)


def test_every_case_is_a_copy_and_a_target(type_1: Phantom) -> None:
    env = made(type_1)
    assert env.cases == 6
    names = []
    for case in range(env.cases):
        _, info = env.reset(seed=0, options={"case": case})
        names.append((info["phantom"], info["target"]))
    assert names[::2] == [("type_1", "bca"), ("type_1_copy1", "bca"), ("type_1_copy2", "bca")]
    assert len(set(names)) == 6


def test_copy_0_is_the_environment_of_the_scan_bit_for_bit(type_1: Phantom) -> None:
    env = made(type_1)
    env.reset(seed=3, options={"case": 0})
    start = env.start_state()[:-1]
    plain = NavigateEnv(type_1, "bca", accuracy="fast", observation=("roadmap", "history"), reward="geodesic")
    seen = plain.reset(seed=1, options={"start": start})[0]
    env.current.reset(seed=1, options={"start": start})
    for _ in range(25):
        mine, theirs = env.step(np.array([1.0, 0.3])), plain.step(np.array([1.0, 0.3]))
        assert mine[1] == theirs[1]
    np.testing.assert_array_equal(mine[0]["roadmap"], theirs[0]["roadmap"])
    assert seen.keys() == mine[0].keys()


def test_the_roadmap_is_the_scans_in_its_wrong_pose(type_1: Phantom) -> None:
    env = made(type_1, perturbation=Perturbation(walls=1e-3, shift=3e-3, turn=0.05, breathing=0.0))
    env.reset(seed=0, options={"case": env.case_of(1)})
    for _ in range(30):
        env.step(np.array([1.0, 0.0]))
    roadmap, simulation = env.current.roadmap, env.simulation
    tip, scan = simulation.tip, roadmap.scan
    place = scan.place(tip)
    np.testing.assert_allclose(scan.rotation.T @ (place - scan.shift - scan.middle) + scan.middle, tip, atol=1e-12)
    assert 1e-3 < np.linalg.norm(place - tip) < 0.02
    # what a ray in the scan from there would meet, along the turned axis of the tip
    ahead = scan.directions(roadmap.frame())[:, 2]
    walked = 0.0
    while walked < 0.03 and type_1.grid.sample(place + walked * ahead) > 0:
        walked += 1e-4
    assert roadmap.walls(place, scan.directions(roadmap.frame()))[0] == pytest.approx(walked, abs=1e-3)
    assert roadmap.read()[21] == pytest.approx(roadmap.way(place)[1] / 0.2, rel=1e-5)
    # success is measured in the patient
    assert env.current._info(tip, env.current.arrival(tip), success=False, invalid=False)["tip"] is tip
    assert env.phantom.name == "type_1_copy1"


WIRE = load_guidewire("default")


def test_differences_fill_their_ranges_and_stay_within(type_1: Phantom) -> None:
    copies = [copy_of(type_1, WIRE, Perturbation(walls=0.0), seed) for seed in range(1, 200)]
    assert all(copy["phantom"] is type_1 for copy in copies)
    shifts = np.array([copy["scan"].shift for copy in copies])
    turns = np.degrees([np.linalg.norm(copy["scan"].turn) for copy in copies])
    stiffness = np.array([copy["wire"].shaft_stiffness_nmm2 / WIRE.shaft_stiffness_nmm2 for copy in copies])
    tips = np.array([copy["wire"].tip_stiffness_nmm2 / WIRE.tip_stiffness_nmm2 for copy in copies])
    friction = np.array([copy["wire"].friction / WIRE.friction for copy in copies])
    breaths = np.array([copy["breathing"].amplitude for copy in copies])
    np.testing.assert_allclose(tips, stiffness)
    for values, low, high in (
        (shifts, -0.003, 0.003),
        (turns, 0.0, 3.0),
        (stiffness, 0.7, 1.3),
        (friction, 0.7, 1.3),
        (breaths, 0.0, 0.005),
    ):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
    caudal = [copy["breathing"].farthest[2] / copy["breathing"].amplitude for copy in copies]
    assert max(caudal) < 0.0
    assert np.mean(caudal) < -0.7


FARTHEST = 1e-3  # m


def test_walls_move_by_up_to_the_largest_displacement_in_and_out(type_1: Phantom) -> None:
    copy = displaced_walls(type_1, 3, FARTHEST)
    moved = -type_1.grid.sample(copy.lumen_mesh.vertices)  # outwards
    assert -1.1 * FARTHEST < moved.min() < -0.5 * FARTHEST
    assert 0.5 * FARTHEST < moved.max() < 1.1 * FARTHEST
    assert 0.2 * FARTHEST < np.abs(moved).mean() < 0.7 * FARTHEST


@pytest.mark.parametrize("between", [1.2e-3, 3e-3])
def test_a_wall_between_two_vessels_never_opens(between: float, type_1: Phantom) -> None:
    place = 0.005 + between / 2
    scan = dataclasses.replace(type_1, hash=f"tubes {between}", grid=tubes((-place, 0.005), (place, 0.005)))
    heights, grown = np.arange(0.004, 0.046, 0.002), []
    for seed in range(6):
        grid = displaced_walls(scan, seed, FARTHEST).grid
        assert min(wall_at(grid, height) - wall_at(scan.grid, height) for height in heights) > -0.15e-3
        far = np.stack([np.full_like(heights, place + 0.005), np.zeros_like(heights), heights], axis=1)
        grown.append(grid.sample(far).max() - scan.grid.sample(far).max())
    assert max(grown) > 0.5 * FARTHEST  # on the other side they still grow


def test_a_share_of_the_differences() -> None:
    half = Perturbation().scaled(0.5)
    assert half.walls == 0.5e-3
    assert half.period == 4.0
    assert half.friction == pytest.approx(0.15)
    with pytest.raises(ValueError, match=r"walls must lie in 0 to 0.02 m, got 1"):
        Perturbation(walls=1)
