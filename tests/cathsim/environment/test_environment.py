"""The Gymnasium environment: one conformance suite over its configurations, determinism, and bad input."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import ENVIRONMENT, PHANTOMS, NavigateEnv
from cathsim.observations.observables import OBSERVABLES

MakeEnv = Callable[..., NavigateEnv]

INFO = {
    "tip": (3,),
    "distance": (),
    "branch": (),
    "depth": (),
    "insertion": (),
    "rotation": (),
    "force": (),
    "force_vector": (3,),
    "success": (),
    "success_lumen": (),
    "invalid": (),
}
ACTION_SIZE = {"feeder": 2, "tip_motors": 21}
# warnings of the checkers that say nothing about the environment: joint angles and speeds have no natural bounds
HARMLESS = ("minimum value is -infinity", "maximum value is infinity", "not within the expected range")


def actions(env: NavigateEnv, count: int, seed: int = 0) -> np.ndarray:
    """Mostly forwards: shape (count, actions)."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count, *env.action_space.shape))
    index = -1 if env.action_space.shape[0] > 2 else 0
    drawn[:, index] = 0.3 + 0.7 * drawn[:, index]
    return drawn.astype(np.float32)


def digest(env: NavigateEnv, steps: int, seed: int) -> str:
    """Digest of everything that an episode gives: observations, rewards, endings, forces."""
    hasher = hashlib.sha256()

    def take(*values: Any) -> None:
        for value in values:
            for part in value.values() if isinstance(value, dict) else [value]:
                hasher.update(np.asarray(part).tobytes())

    take(*env.reset(seed=seed))
    for action in actions(env, steps, seed):
        take(*env.step(action))
    return hasher.hexdigest()


@pytest.mark.parametrize(
    ("phantom", "kind", "wire"),
    [
        *((phantom, "feeder", "default") for phantom in PHANTOMS),
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
    for action in actions(env, 12):
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


@pytest.mark.parametrize(("wire", "size"), [("default", 112), ("thesis", 336)])
def test_joint_observation_has_the_size_of_the_thesis(make_env: MakeEnv, wire: str, size: int) -> None:
    assert make_env(wire=wire, observation="joints").observation_space.shape == (size,)


@pytest.mark.parametrize("name", ["shape", "sequential", "roadmap"])
def test_a_single_observation_is_an_array(make_env: MakeEnv, name: str) -> None:
    env = make_env(observation=name)
    observation, _ = env.reset(seed=0)
    assert isinstance(env.observation_space, gymnasium.spaces.Box)
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])


@pytest.mark.parametrize(
    "arguments",
    [
        {"observation": ("joints", "image", "mask")},
        {"observation": "sequential", "render_mode": "fluoroscopy"},
        {"actions": "tip_motors", "reward": "geodesic"},
    ],
    ids=str,
)
def test_checkers_find_nothing(arguments: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame")  # an extra: they try every render mode
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    from gymnasium.utils.env_checker import check_env as gymnasium_check

    checks = [gymnasium_check]
    try:
        from stable_baselines3.common.env_checker import check_env as sb3_check
    except ImportError:  # an extra
        pass
    else:
        checks.append(sb3_check)
    for check in checks:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            env = gymnasium.make(ENVIRONMENT, accuracy="fast", **arguments)
            check(env.unwrapped)
            env.close()
        found = [str(warning.message) for warning in caught]
        assert not [text for text in found if not any(harmless in text for harmless in HARMLESS)]


def test_made_environment_steps_through_its_wrappers() -> None:
    env = gymnasium.make(ENVIRONMENT, phantom="type_2", target="lsa", accuracy="fast", max_steps=2)
    assert isinstance(env.unwrapped, NavigateEnv)
    env.reset(seed=0)
    assert env.step(np.ones(2, np.float32))[3] is False
    assert env.step(np.ones(2, np.float32))[3] is True
    env.close()


def test_same_seed_gives_the_same_bits(make_env: MakeEnv) -> None:
    arguments = {"observation": OBSERVABLES, "image_size": 40, "start_rotation": 1.0}
    env = make_env(**arguments)
    first = digest(env, 70, seed=3)
    assert digest(make_env(**arguments), 70, seed=3) == first
    assert digest(env, 100, seed=4) != first
    assert digest(env, 70, seed=3) == first, "an earlier episode left its trace"


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"phantom": "aorta"}, "unknown phantom 'aorta'; choose from type_1, "),
        ({"phantom": "random"}, "phantom 'random' needs a seed"),
        ({"target": "coronary"}, "unknown target 'coronary' in phantom 'type_1'; choose from bca, "),
        ({"entry": "radial"}, "unknown entry 'radial' in phantom 'type_1'; choose from descending, ascending"),
        ({"wire": "steel"}, "unknown guidewire 'steel'; there are default, "),
        ({"accuracy": "exact"}, "unknown accuracy 'exact'; there are reference, "),
        ({"actions": "tip"}, "unknown actions 'tip'; there are feeder, tip_motors"),
        ({"observation": "pixels"}, "unknown observation 'pixels'; there are internal, "),
        ({"observation": ()}, "observation must name at least one observable"),
        ({"render_mode": "ansi"}, "unknown render_mode 'ansi'; there are human, rgb_array, fluoroscopy"),
        ({"reward": "sparse"}, "unknown reward 'sparse'; there are distance, geodesic"),
        ({"colour": "red"}, "the environment has no argument colour; the task's are target, success_radius"),
    ],
    ids=str,
)
def test_bad_arguments_are_named_in_one_sentence(make_env: MakeEnv, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        make_env(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([np.nan, 0.0], r"expected a finite action, got \[nan, 0.0\]"),
        ([0.0, np.inf], "expected a finite action"),
        ([0.0], r"expected an action of shape \(2,\), got \(1,\)"),
        ([[0.0, 0.0]], r"expected an action of shape \(2,\), got \(1, 2\)"),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(make_env: MakeEnv, action: list[Any], message: str) -> None:
    env = make_env()
    env.reset(seed=0)
    before = env.simulation.state()
    with pytest.raises(ValueError, match=message):
        env.step(np.array(action))
    assert np.array_equal(env.simulation.state(), before)
    assert env.steps == 0


def test_actions_beyond_the_box_are_clipped(make_env: MakeEnv) -> None:
    one, other = make_env(observation="joints"), make_env(observation="joints")
    one.reset(seed=0)
    other.reset(seed=0)
    assert np.array_equal(one.step(np.array([3.0, -9.0]))[0], other.step(np.array([1.0, -1.0]))[0])


def test_a_step_needs_a_running_episode(make_env: MakeEnv) -> None:
    env = make_env(max_steps=1)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"the episode has ended: call reset\(\) before step\(\)"):
            env.step(np.zeros(2))
        env.reset()
        env.step(np.zeros(2))


def test_environments_on_one_phantom_are_independent(make_env: MakeEnv) -> None:
    env = make_env(phantom="random", phantom_seed=3, target="bca")
    assert env.phantom.name == "random_3"
    assert make_env(phantom=env.phantom).phantom is env.phantom
    env.reset(seed=0)
    observation = env.observe()
    other = make_env(phantom=env.phantom)
    other.reset(seed=0)
    for _ in range(5):
        other.step(np.ones(2))
    assert np.array_equal(env.observe(), observation)


def test_fluoroscopy_render_mode_needs_no_opengl(make_env: MakeEnv) -> None:
    env = make_env(render_mode="fluoroscopy", image_size=64)
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((64, 64, 3), np.uint8)
    assert make_env().render() is None
