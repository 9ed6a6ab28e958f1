"""The environment over copies: its cases, what they differ in, and that a policy sees the scan."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from cathsim import NavigateEnv, Phantom
from cathsim.rehearsal.environment import NavigateCopiesEnv
from cathsim.rehearsal.perturbation import Perturbation

ID = "cathsim:cathsim/NavigateCopies-v0"


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
    assert roadmap.scan is not None
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


def test_it_is_made_by_its_id_and_again_from_json(type_1: Phantom) -> None:
    settings = {"phantom": "type_1", "targets": ("bca",), "copies": (1, 5), "perturbation": Perturbation(walls=5e-4)}
    env = gymnasium.make(ID, **settings, accuracy="fast", observation="tip", disable_env_checker=True)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    first, second = (one.reset(seed=2) for one in (env, again))
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1]["phantom"] == second[1]["phantom"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"copies": ()}, "copies must list at least one seed"),
        ({"copies": (-1,)}, r"none below 0, got \[-1\]"),
        ({"breathing": None}, "copies bring their own breathing"),
        ({"perturbation": "strong"}, "perturbation must be a Perturbation, got 'strong'"),
        ({"wire": None}, "copies differ in the wire's stiffness"),
    ],
)
def test_bad_arguments_are_refused(type_1: Phantom, changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        NavigateCopiesEnv(type_1, **changed)
