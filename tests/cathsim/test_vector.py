"""Environments stepped together: same results as alone, resets, infos, bad input."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import ENVIRONMENT, NavigateEnv, ThreadedVectorEnv

MakeEnv = Callable[..., NavigateEnv]
MakeVector = Callable[..., ThreadedVectorEnv]


@pytest.fixture
def make_vector() -> Iterator[MakeVector]:
    made: list[ThreadedVectorEnv] = []

    def make(num_envs: int = 3, **arguments: Any) -> ThreadedVectorEnv:
        made.append(ThreadedVectorEnv(num_envs, **{"accuracy": "fast", "observation": "joints", **arguments}))
        return made[-1]

    yield make
    for vector in made:
        vector.close()


def actions(count: int, num_envs: int = 3, seed: int = 0) -> np.ndarray:
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count, num_envs, 2))
    drawn[..., 0] = np.abs(drawn[..., 0])
    return drawn


@pytest.mark.parametrize("threads", [1, 8])
def test_environments_step_together_as_they_do_alone(make_vector: MakeVector, make_env: MakeEnv, threads: int) -> None:
    variations = [{"target": "bca"}, {"target": "lcca"}, {"phantom": "type_2", "reward": "geodesic"}]
    vector = make_vector(variations=variations, threads=threads)
    alone = [make_env(observation="joints", **variation) for variation in variations]
    together, infos = vector.reset(seed=5)
    for index, env in enumerate(alone):
        observation, info = env.reset(seed=5 + index)
        assert np.array_equal(together[index], observation)
        assert infos["distance"][index] == info["distance"]
    for step in actions(40):
        together, rewards, terminated, truncated, infos = vector.step(step)
        for index, env in enumerate(alone):
            observation, reward, *endings, info = env.step(step[index])
            assert np.array_equal(together[index], observation)
            assert rewards[index] == reward
            assert [terminated[index], truncated[index]] == endings
            assert np.array_equal(infos["force_vector"][index], info["force_vector"])
            assert infos["success"][index] == info["success"]


def test_two_devices_step_together_as_they_do_alone(make_vector: MakeVector, make_env: MakeEnv) -> None:
    variations = [{"catheter": "vertebral"}, {"catheter": "simmons2", "torsion": "rigid"}, {"catheter": "jb2_6f"}]
    vector = make_vector(variations=variations, observation="devices", threads=2)
    alone = [make_env(observation="devices", **variation) for variation in variations]
    vector.reset(seed=5)
    for index, env in enumerate(alone):
        env.reset(seed=5 + index)
    for step in np.random.default_rng(0).uniform(-0.5, 1, (15, 3, 4)):
        together, _, _, _, infos = vector.step(step)
        for index, env in enumerate(alone):
            observation, *_, info = env.step(step[index])
            assert np.array_equal(together[index], observation)
            assert np.array_equal(infos["feeder_forces"][index], info["feeder_forces"])
            assert infos["lead"][index] == info["lead"]


def test_make_vec_gives_the_threaded_environment() -> None:
    vector = gymnasium.make_vec(ENVIRONMENT, num_envs=2, accuracy="fast", observation=("joints", "image"), max_steps=4)
    assert isinstance(vector.unwrapped, ThreadedVectorEnv)
    observations, infos = vector.reset(seed=0)
    assert vector.observation_space.contains(observations)
    assert observations["image"].shape == (2, 1, 80, 80)
    assert infos["tip"].shape == infos["force_vector"].shape == (2, 3)
    assert infos["_tip"].tolist() == [True, True]
    observations, rewards, terminated, truncated, infos = vector.step(vector.action_space.sample())
    assert vector.observation_space.contains(observations)
    assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float64, bool, bool)
    assert infos["force"].shape == (2,)
    assert "contact_points" not in infos
    vector.close()


def test_a_mask_resets_only_some(make_vector: MakeVector) -> None:
    vector = make_vector(observation=("joints", "sequential"), max_steps=4)
    vector.reset(seed=0)
    for step in actions(4):
        before, _, _, truncated, _ = vector.step(step)
    assert truncated.all()
    mask = np.array([True, False, False])
    after, infos = vector.reset(options={"reset_mask": mask})
    for name in ("joints", "sequential"):
        assert np.array_equal(after[name][1:], before[name][1:])
    assert after["joints"][0, 0] < 1.1e-3
    assert infos["_tip"].tolist() == mask.tolist()
    _, rewards, *_ = vector.step(actions(1)[0])
    assert rewards[0] < 0, "the one that was reset goes on"
    assert rewards[1:].tolist() == [0.0, 0.0], "the others are reset now"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must lie in 1 to 100000, got 0"),
        ({"autoreset_mode": "never"}, "unknown autoreset_mode 'never'; there are NextStep, SameStep, Disabled"),
        ({"variations": [{}]}, "expected 3 variations, one an environment, got 1"),
        ({"variations": [{}, {}, {"wire": "thesis"}]}, "all environments of a vector need the same action and obs"),
        ({"threads": 0}, "threads must lie in 1 to 100000, got 0"),
        ({"phantom": "aorta"}, "unknown phantom 'aorta'"),
    ],
    ids=str,
)
def test_bad_arguments(make_vector: MakeVector, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_vector(**arguments)


def test_bad_input_to_a_running_vector(make_vector: MakeVector) -> None:
    vector = make_vector()
    vector.reset(seed=0)
    with pytest.raises(ValueError, match=r"expected actions of shape \(3, 2\), got \(2, 2\)"):
        vector.step(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="expected a finite action"):
        vector.step(np.full((3, 2), np.nan))
    with pytest.raises(ValueError, match=r"expected a reset_mask of shape \(3,\), got \(2,\)"):
        vector.reset(options={"reset_mask": np.array([True, False])})
