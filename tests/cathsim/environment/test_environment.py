"""The environment keeps Gymnasium's contract; entries, starts, messages."""

import hashlib
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.anatomy import Phantom
from cathsim.anatomy.entry import AHEAD
from cathsim.observations.fluoroscopes import SHOWN_SHEATH, shown_points
from cathsim.observations.observables import OBSERVABLES
from tests.cathsim.equal_observations import same
from tests.cathsim.forward_actions import forward_actions
from tests.cathsim.makers import MakeEnv

SINGLE = ("distance", "branch", "depth", "insertion", "rotation", "force", "success", "success_lumen", "invalid")
INFO = {"tip": (3,), "force_vector": (3,), **dict.fromkeys(SINGLE, ())}
ACTION_SIZE = {"feeder": 2, "tip_motors": 21}


def digest(env: NavigateEnv, steps: int, seed: int) -> str:
    """Digest of everything that an episode gives: observations, rewards, endings, forces."""
    hasher = hashlib.sha256()

    def take(*values: Any) -> None:
        for value in values:
            for part in value.values() if isinstance(value, dict) else [value]:
                hasher.update(np.asarray(part).tobytes())

    take(*env.reset(seed=seed))
    for action in forward_actions(steps, *env.action_space.shape, seed=seed):
        take(*env.step(action))
    return hasher.hexdigest()


@pytest.mark.parametrize(
    ("phantom", "kind", "wire"),
    [
        ("type_2", "feeder", "default"),
        ("type_1", "tip_motors", "default"),
        ("type_1", "feeder", "thesis"),
        ("bovine", "tip_motors", "nitrex_straight"),
    ],
)
def test_every_configuration_keeps_the_contract(make_env: MakeEnv, phantom: str, kind: str, wire: str) -> None:
    env = make_env(phantom=phantom, wire=wire, actions=kind, observation=OBSERVABLES, image_size=40, target="lcca")
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (ACTION_SIZE[kind],), np.float32)
    space = env.observation_space
    assert isinstance(space, gymnasium.spaces.Dict)
    assert set(space) == set(OBSERVABLES)
    links = len(env.simulation.wire.links)
    assert space["joints"].shape == (4 * links,)
    assert space["internal"].shape == (6 * links + 22 * links,)
    assert space["shape"].shape == (links + 1, 3)
    assert space["image"].shape == space["mask"].shape == (1, 40, 40)
    assert space["sequential"].shape == (3, 40, 40)

    observation, info = env.reset(seed=1)
    steps = [(observation, None, info)]
    for action in forward_actions(12, ACTION_SIZE[kind]):
        observation, reward, terminated, truncated, info = env.step(action)
        assert type(reward) is float
        assert np.isfinite(reward)
        assert type(terminated) is bool
        assert type(truncated) is bool
        steps.append((observation, {name: value.copy() for name, value in observation.items()}, info))
    seen: list[np.ndarray] = []
    for observation, copied, info in steps:
        assert space.contains(observation)
        assert all(np.isfinite(value).all() for value in observation.values())
        assert not any(np.shares_memory(a, b) for a in observation.values() for b in seen)
        seen = [*seen, *observation.values()]
        for name, value in (copied or {}).items():
            assert np.array_equal(observation[name], value), f"{name} was overwritten by a later step"
        assert INFO.keys() == info.keys()
        for name, shape in INFO.items():
            assert np.shape(info[name]) == shape, name
            assert name == "branch" or np.isfinite(info[name]).all(), name
        assert not info["invalid"]
    assert info["insertion"] > steps[0][2]["insertion"]


def test_same_seed_gives_the_same_bits(make_env: MakeEnv) -> None:
    arguments = {"observation": OBSERVABLES, "image_size": 40, "start_rotation": 1.0}
    env = make_env(**arguments)
    first = digest(env, 50, seed=3)
    assert digest(make_env(**arguments), 50, seed=3) == first
    assert digest(env, 50, seed=4) != first
    assert digest(env, 50, seed=3) == first, "an earlier episode left its trace"


def test_an_invalid_state_ends_the_episode_and_the_next_is_sound(make_env: MakeEnv) -> None:
    env = make_env()
    reference = digest(env, 5, seed=0)
    env.reset(seed=0)
    env.step(np.ones(2))
    env.simulation.data.qvel[7] = np.nan
    observation, reward, terminated, truncated, info = env.step(np.ones(2))
    assert (terminated, truncated, info["invalid"], info["success"]) == (False, True, True, False)
    assert np.isfinite(observation).all()
    assert np.isfinite(reward)
    assert np.isfinite(info["force_vector"]).all()
    assert digest(env, 5, seed=0) == reference


def test_bad_actions_are_refused_and_change_nothing(make_env: MakeEnv) -> None:
    env = make_env()
    env.reset(seed=0)
    before = env.simulation.state()
    for action, message in (
        ([np.nan, 0.0], "expected a finite action"),
        ([0.0, np.inf], "expected a finite action"),
        ([0.0], r"expected an action of shape \(2,\), got \(1,\)"),
        ([[0.0, 0.0]], r"got \(1, 2\)"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(np.array(action))
    assert np.array_equal(env.simulation.state(), before)
    assert env.steps == 0


def test_a_step_needs_a_running_episode(make_env: MakeEnv) -> None:
    env = make_env(max_steps=1)
    for said in ("no episode was started", "the episode has ended"):
        with pytest.raises(RuntimeError, match=rf"{said}: call reset\(\) before step\(\)"):
            env.step(np.zeros(2))
        env.reset()
        env.step(np.zeros(2))


@pytest.mark.parametrize("named", [True, False])
def test_wire_begins_at_its_entry_and_goes_in(type_1: Phantom, named: bool) -> None:
    aorta = type_1.tree.root
    entry = "lsa_end" if named else tuple(aorta.point_at(0.3 * aorta.length).tolist())
    env = NavigateEnv(type_1, "bca", entry=entry, observation=("roadmap", "image"), accuracy="fast")
    gate = type_1.entry(env.simulation.entry)
    env.reset(seed=0)
    assert np.linalg.norm(env.simulation.tip - gate.position) < 3 * AHEAD  # a bent tip springs aside
    for _ in range(15):
        _, _, _, truncated, info = env.step(np.array([1.0, 0.3]))
        assert not truncated
    assert info["insertion"] > 0.02
    assert type_1.grid.sample(info["tip"]) > -1e-3
    drawn = shown_points(env.simulation)
    assert np.linalg.norm(drawn[-1] - (gate.position - SHOWN_SHEATH * gate.direction)) < 1e-9


def test_episode_starts_where_a_wire_was_left(make_env: MakeEnv) -> None:
    environment = make_env(observation=("joints", "sequential", "force"), reward="geodesic", start_rotation=np.pi)
    environment.reset(seed=3)
    for action in forward_actions(30, 2):
        environment.step(action)
    tip, start = environment.simulation.tip, environment.simulation.state()
    environment.reset(seed=4)
    _, info = environment.reset(options={"start": start})
    assert np.array_equal(info["tip"], tip)
    assert environment.steps == 0
    assert info["force"] == 0.0


KEYS = ("roadmap", "history", "image", "joints", "sequential", "tracking", "force")
STEPS = 14


def observed_every(number: int) -> NavigateEnv:
    task = {"reward": "geodesic", "max_steps": STEPS}
    return NavigateEnv("type_1", "bca", observation=KEYS, accuracy="fast", observe_every=number, **task)


def test_what_is_observed_is_what_is_observed_at_every_step() -> None:
    chosen, rows = np.random.default_rng(0).uniform(-1, 1, (STEPS, 2)), []
    for number in (1, 3):
        env = observed_every(number)
        start, _ = env.reset(seed=3)
        rows.append([(start, 0.0, False, False), *(env.step(action)[:4] for action in chosen)])
    every, third = rows
    assert every[STEPS][3]
    for step, (one, other) in enumerate(zip(every, third, strict=True)):
        assert one[1:] == other[1:]
        if step % 3 == 0 or step == STEPS:  # the episode ends at 14, no multiple of 3
            assert same(one[0], other[0])
        else:
            assert other[0] is third[step - step % 3][0]


def test_a_saved_moment_has_the_observation_that_was_last_made() -> None:
    tried, again = observed_every(5), observed_every(5)
    tried.reset(seed=1)
    for action in np.random.default_rng(2).uniform(0, 1, (7, 2)):
        last = tried.step(action)[0]
    again.reset(seed=2)
    assert same(again.restore(tried.state()), last)
    for _ in range(4):  # the third is observed anew
        assert same(again.step(np.zeros(2))[0], tried.step(np.zeros(2))[0])
