"""Targets that are points in the lumen, and tasks with a reward of their own."""

import dataclasses
import pickle

import numpy as np
import pytest

from cathsim import NavigationTask, Phantom, load_guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.planning.plan_trials import ExpertSettings
from cathsim.planning.sampling import SamplingExpert
from cathsim.vector import ThreadedVectorEnv
from tests.cathsim.makers import MakeEnv

FORWARD = np.array([1.0, 0.2], np.float32)
GUIDED = ("roadmap", "history", "goal", "goal_image", "tip")


@pytest.fixture
def point(type_1: Phantom) -> tuple[float, float, float]:
    """Where the target of the left subclavian artery is."""
    x, y, z = type_1.target("lsa").position.tolist()
    return x, y, z


@pytest.fixture
def beside(type_1: Phantom, point: tuple[float, ...]) -> np.ndarray:
    """A place near it, off the centreline."""
    place = np.array(point) + np.array([0.001, 0.0, 0.002])
    assert type_1.grid.sample(place) > 0
    return place


def test_a_point_gives_the_episodes_of_the_name_whose_place_it_is(make_env: MakeEnv, point: tuple[float, ...]) -> None:
    arguments = {"observation": GUIDED, "reward": "geodesic", "phantom": "type_1"}
    named, pointed = make_env(target="lsa", **arguments), make_env(target=point, **arguments)
    assert pointed.task.target == point
    one, other = named.reset(seed=0), pointed.reset(seed=0)
    for _ in range(30):
        assert all(np.array_equal(one[0][name], other[0][name]) for name in GUIDED)
        assert one[-1]["distance"] == other[-1]["distance"]
        one, other = named.step(FORWARD), pointed.step(FORWARD)
        assert one[1:4] == other[1:4]


def test_everything_follows_the_target_of_an_episode(make_env: MakeEnv, beside: np.ndarray) -> None:
    arguments = {"observation": GUIDED, "reward": "geodesic", "phantom": "type_1"}
    env, fresh = make_env(target="bca", **arguments), make_env(target=beside, **arguments)
    env.reset(seed=3)
    env.step(FORWARD)
    one, other = env.reset(seed=0, options={"target": beside}), fresh.reset(seed=0)
    assert np.array_equal(env.goal, beside)
    for _ in range(20):
        assert all(np.array_equal(one[0][name], other[0][name]) for name in GUIDED)
        assert one[-1]["distance"] == other[-1]["distance"]
        assert one[-1]["distance"] == pytest.approx(np.linalg.norm(one[-1]["tip"] - beside), rel=1e-12)
        one, other = env.step(FORWARD), fresh.step(FORWARD)
        assert one[1] == other[1]
    # saved in the middle, and gone on with by another environment
    saved = pickle.loads(pickle.dumps(env.state()))
    expected = [env.step(FORWARD) for _ in range(5)]
    third = make_env(target="lcca", **arguments)
    third.restore(saved)
    for step in expected:
        found = third.step(FORWARD)
        assert all(np.array_equal(step[0][name], found[0][name]) for name in GUIDED)
        assert step[1] == found[1]
    # the option is of one episode
    env.reset(seed=0)
    assert env.task.target == "bca"
    assert env.reset(seed=0, options={"target": "lsa"})[1]["distance"] > 0
    assert env.task.target == "lsa"


def test_targets_that_cannot_be_are_refused_and_change_nothing(make_env: MakeEnv, type_1: Phantom) -> None:
    env = make_env(phantom=type_1, observation="goal")
    first, _ = env.reset(seed=0)
    place = type_1.grid.coordinates(np.argwhere(type_1.grid.values > 0)[0])
    for target, message in (
        (place + 0.5, r"lies outside the lumen of type_1: the nearest place inside is \(.*\) m"),
        (place * 1e3, "coordinates are in metres"),
        (place[:2], "a point of three coordinates in m"),
        ([np.nan, 0.0, 0.0], "a point of three coordinates in m"),
        ("coronary", "unknown target 'coronary'"),
        (7, "a point of three coordinates in m, got 7"),
    ):
        state = env.state()
        with pytest.raises(ValueError, match=message):
            env.reset(seed=5, options={"target": target})
        assert env.state()["generator"] == state["generator"]
        assert env.task.target == "bca"
        assert np.array_equal(env.observe(), first)
        with pytest.raises(ValueError, match=message):
            make_env(phantom=type_1, target=target)


def test_a_point_out_of_reach_is_refused(make_env: MakeEnv, type_1: Phantom) -> None:
    far = type_1.target("rcca_end").position
    with pytest.raises(ValueError, match=r"the wire of .* mm is too short for point_.*_mm of type_1"):
        make_env(phantom=type_1, target=far, wire=load_guidewire("default").scaled(0.2))


def test_the_expert_follows_the_target_of_an_episode(make_env: MakeEnv, point: tuple[float, ...]) -> None:
    settings = ExpertSettings(horizon=6, samples=4, elites=2, rounds=1)
    env, fresh = make_env(phantom="type_1", target="bca"), make_env(phantom="type_1", target=point)
    experts = [SamplingExpert(one, settings=settings, threads=1) for one in (env, fresh)]
    env.reset(seed=0, options={"target": point})
    fresh.reset(seed=0)
    for _ in range(3):
        first, second = (expert.action() for expert in experts)
        assert np.array_equal(first, second)
        env.step(first)
        fresh.step(second)
    assert np.array_equal(experts[0].environment.goal, point)


class Progress(NavigationTask):
    """Rewards what is gained along the lumen, less the tip's way."""

    def step_reward(
        self, distance: float, progress: float, force: float, moved: float = 0.0, *, success: bool
    ) -> float:
        return progress - 1e-3 * moved


def test_a_tasks_own_reward_is_given_the_progress(make_env: MakeEnv, type_1: Phantom) -> None:
    env = make_env(phantom=type_1, task=Progress(target="lcca"))
    _, info = env.reset(seed=0)
    total = moved = 0.0
    for _ in range(20):
        before, tip = float(type_1.geodesic_distance(info["tip"], "lcca")), info["tip"]
        _, reward, *_, info = env.step(FORWARD)
        progress = before - float(type_1.geodesic_distance(info["tip"], "lcca"))
        moved += float(np.linalg.norm(info["tip"] - tip))
        assert reward == pytest.approx(progress - 1e-3 * np.linalg.norm(info["tip"] - tip), abs=1e-12)
        total += reward
    assert total > 0.5 * moved > 0.005


def test_vectors_and_many_anatomies_take_a_tasks_own_reward(type_1: Phantom) -> None:
    task = Progress(max_steps=50)
    rewards: list[list[float]] = []
    vector = ThreadedVectorEnv(2, phantom=type_1, accuracy="fast", task=task)
    many = NavigateManyEnv((type_1,), ("bca", "lcca"), accuracy="fast", task=task)
    vector.reset(seed=0)
    many.reset(seed=0, options={"case": 1})
    assert many.task == dataclasses.replace(task, target="lcca"), "the case's target, not the task's"
    for _ in range(10):
        gained = vector.step(np.tile(FORWARD, (2, 1)))[1].tolist()
        rewards.append([*gained, float(many.step(FORWARD)[1])])
    assert (np.sum(rewards, axis=0) > 0.005).all()
    vector.close()


def test_many_anatomies_take_points(type_1: Phantom, beside: np.ndarray, point: tuple[float, ...]) -> None:
    env = NavigateManyEnv((type_1,), ("bca", beside), observation="goal", accuracy="fast")
    goal, info = env.reset(seed=0, options={"case": 1})
    assert np.array_equal(goal, beside.astype(np.float32))
    assert info["target"].startswith("point_")
    goal, info = env.reset(seed=0, options={"case": 0, "target": point})
    assert np.array_equal(goal, np.float32(point))
    env.step(FORWARD)
    state = pickle.loads(pickle.dumps(env.state()))
    env.reset(seed=1, options={"case": 1})
    assert np.array_equal(env.restore(state), goal)
    with pytest.raises(ValueError, match="a target is a name, or a point"):
        NavigateManyEnv((type_1,), point, accuracy="fast")
