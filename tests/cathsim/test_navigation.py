"""The task: start, success, reward, truncation."""

from typing import Any

import numpy as np
import pytest

from cathsim import NavigationTask, Phantom
from cathsim.navigation import POTENTIAL_PER_METRE, STEP_COST, Goal
from tests.cathsim.makers import MakeEnv

FORWARD = np.array([1.0, 0.0])


def test_thesis_reward_is_minus_the_distance_in_metres(make_env: MakeEnv, type_1: Phantom) -> None:
    env = make_env(target="bca")
    env.reset(seed=0)
    for _ in range(20):
        _, reward, terminated, _, info = env.step(FORWARD)
        distance = np.linalg.norm(env.simulation.tip - type_1.targets["bca"].position)
        assert reward == pytest.approx(-distance, abs=1e-12)
        assert info["distance"] == pytest.approx(distance, abs=1e-12)
        assert not terminated


def test_a_function_gives_the_reward(make_env: MakeEnv) -> None:
    seen: list[dict[str, Any]] = []

    def gain(info: dict[str, Any]) -> np.float64:
        seen.append(info)
        return np.float64(100.0 * info["progress"] - abs(info["action"][1]))

    env, geodesic = make_env(target="bca", reward=gain), make_env(target="bca", reward="geodesic")
    env.reset(seed=0)
    geodesic.reset(seed=0)
    for _ in range(5):
        _, reward, _, _, info = env.step(np.array([1.0, 0.25]))
        _, known, *_ = geodesic.step(np.array([1.0, 0.25]))
        assert type(reward) is float
        assert reward == pytest.approx(known + STEP_COST - 0.25, abs=1e-12)
        assert seen[-1].keys() == {*info, "progress", "moved", "action"}
    priced = make_env(target="bca", reward=lambda info: 1.0, path_penalty=20.0)
    priced.reset(seed=0)
    _, reward, _, _, info = priced.step(np.array([1.0, 0.25]))
    assert reward == pytest.approx(1.0 - 20.0 * seen[0]["moved"], abs=1e-12)


@pytest.mark.parametrize("given", [None, float("nan"), np.zeros(2), "1"])
def test_a_wrong_reward_is_refused(make_env: MakeEnv, given: object) -> None:
    env = make_env(reward=lambda info: given)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"a reward must be one finite number, own:.*gave") as caught:
        env.step(FORWARD)
    assert "\n" not in str(caught.value)


def test_rewards_of_success_and_of_forces_beyond_a_threshold() -> None:
    assert NavigationTask(reward="geodesic").step_reward(0.1, 0.002, 1.0, success=True) == pytest.approx(10.18)
    assert NavigationTask(force_penalty=0.5).step_reward(0.1, 0.0, 0.4, success=True) == pytest.approx(9.8)
    lenient = NavigationTask(force_penalty=0.5, force_threshold=0.3)
    assert lenient.step_reward(0.1, 0.0, 0.4, success=False) == pytest.approx(-0.15)
    assert lenient.step_reward(0.1, 0.0, 0.2, success=False) == pytest.approx(-0.1)


def test_geodesic_rewards_add_up_to_the_potential(make_env: MakeEnv, type_1: Phantom) -> None:
    env = make_env(target="lcca", reward="geodesic")
    env.reset(seed=0)
    start = type_1.geodesic_distance(env.simulation.tip, "lcca")
    generator = np.random.default_rng(0)
    count = 60
    total = sum(env.step(generator.uniform((-0.2, -1), 1))[1] for _ in range(count))
    end = type_1.geodesic_distance(env.simulation.tip, "lcca")
    assert start - end > 0.02
    assert total == pytest.approx(POTENTIAL_PER_METRE * (start - end) - STEP_COST * count, abs=1e-9)
    env.reset(seed=0)
    again = env.step(FORWARD)[1]
    env.reset(seed=0)
    assert env.step(FORWARD)[1] == again, "the potential starts again with the episode"


def test_penalties_cost_what_the_wall_feels_and_what_the_tip_moves(make_env: MakeEnv) -> None:
    free, strict, short = make_env(), make_env(force_penalty=2.0), make_env(path_penalty=20.0)
    for env in (strict, short):
        env.reset(seed=0)
    before = free.reset(seed=0)[1]["tip"]
    felt = 0.0
    for _ in range(70):
        _, reward, *_, info = free.step(FORWARD)
        assert strict.step(FORWARD)[1] == pytest.approx(reward - 2.0 * info["force"], abs=1e-12)
        moved = np.linalg.norm(info["tip"] - before)
        assert short.step(FORWARD)[1] == pytest.approx(reward - 20.0 * moved, abs=1e-12)
        felt, before = max(felt, info["force"]), info["tip"]
    assert felt > 0.02, "the wire is to touch the wall"


def test_starts_are_jittered_by_up_to_a_millimetre(make_env: MakeEnv) -> None:
    env = make_env()
    env.reset(seed=0)
    insertions = []
    for _ in range(40):
        env.reset()
        insertions.append(env.simulation.insertion)
    assert -1e-6 < min(insertions) < 1e-4
    assert 9e-4 < max(insertions) < 1e-3 + 1e-6
    assert np.std(insertions) == pytest.approx(1e-3 / np.sqrt(12), rel=0.3)


def behind_ostium(phantom: Phantom, branch: str, depth: float) -> np.ndarray:
    """The centreline's point (3,) m at a depth behind a branch's ostium."""
    return phantom.tree[branch].point_at(phantom.tree.ostium_arc(branch) + depth)


@pytest.mark.parametrize(
    ("depth", "lumen"),
    [(-0.002, False), (0.001, True), (0.009, True), (0.0155, False)],
)
def test_success_along_the_lumen_asks_for_the_branch_and_the_way(type_1: Phantom, depth: float, lumen: bool) -> None:
    """A target 6 mm behind the ostium: a tip before the ostium has not reached it, however near it is."""
    target = tuple(behind_ostium(type_1, "lsa", 0.006))
    tip = behind_ostium(type_1, "lsa", depth)
    radius = 0.009
    arrival = Goal(NavigationTask(target=target, success_radius=radius), type_1).arrival(tip)
    straight = Goal(NavigationTask(target=target, success_radius=radius, success="straight"), type_1).arrival(tip)
    assert arrival.success == arrival.success_lumen == straight.success_lumen == lumen
    assert straight.success == (np.linalg.norm(tip - target) <= radius)
    assert arrival.place.branch == ("lsa" if depth > 0 else "aorta")
    assert arrival.place.depth == pytest.approx(max(depth, 0.0), abs=1e-4)


def test_a_tip_that_passes_the_ostium_succeeds_by_the_straight_rule_alone(make_env: MakeEnv, type_1: Phantom) -> None:
    target = tuple(behind_ostium(type_1, "lsa", 0.004))
    envs = [make_env(target=target, success_radius=0.025, success=rule) for rule in ("straight", "lumen")]
    for env in envs:
        env.reset(seed=0)
    for _ in range(120):
        (_, _, ended, _, info), (_, _, other, _, same) = (env.step(FORWARD) for env in envs)
        assert info["branch"] == same["branch"] == "aorta"
        assert info["depth"] == 0.0
        assert not other
        assert not info["success_lumen"]
        if ended:
            break
    assert ended
    assert info["success"]
