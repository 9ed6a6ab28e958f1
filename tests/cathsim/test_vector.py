"""Environments stepped together: same results as alone, resets, infos, bad input."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cathsim import ThreadedVectorEnv
from tests.cathsim.makers import MakeEnv

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


def actions(count: int, size: int = 2) -> np.ndarray:
    """Actions (count, 3, size) of three environments, whose wires go forwards."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (count, 3, size))
    drawn[..., 0] = np.abs(drawn[..., 0])
    return drawn


ARCHES = ({"target": "bca"}, {"target": "lcca"}, {"phantom": "type_2", "reward": "geodesic"})
CATHETERS = ({"catheter": "vertebral"}, {"catheter": "simmons2", "torsion": "rigid"}, {"catheter": "jb2_6f"})


@pytest.mark.parametrize(
    ("observation", "variations", "threads"), [("joints", ARCHES, 1), ("joints", ARCHES, 8), ("devices", CATHETERS, 2)]
)
def test_environments_step_together_as_they_do_alone(
    make_vector: MakeVector, make_env: MakeEnv, observation: str, variations: tuple[dict[str, Any], ...], threads: int
) -> None:
    vector = make_vector(variations=variations, observation=observation, threads=threads)
    alone = [make_env(observation=observation, **variation) for variation in variations]
    together, infos = vector.reset(seed=5)
    for index, env in enumerate(alone):
        observed, info = env.reset(seed=5 + index)
        assert np.array_equal(together[index], observed)
        assert infos["distance"][index] == info["distance"]
    keys = ("force_vector", "success", *(("feeder_forces", "lead") if observation == "devices" else ()))
    for step in actions(40, size=vector.single_action_space.shape[0]):
        together, rewards, terminated, truncated, infos = vector.step(step)
        for index, env in enumerate(alone):
            observed, reward, *endings, info = env.step(step[index])
            assert np.array_equal(together[index], observed)
            assert rewards[index] == reward
            assert [terminated[index], truncated[index]] == endings
            assert all(np.array_equal(infos[key][index], info[key]) for key in keys)


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
        ({"autoreset_mode": "never"}, "unknown autoreset_mode 'never'; there are NextStep, SameStep, Disabled"),
        ({"variations": [{}]}, "expected 3 variations, one an environment, got 1"),
        ({"variations": [{}, {}, {"wire": "thesis"}]}, "all environments of a vector need the same action and obs"),
        ({"threads": 0}, "threads must lie in 1 to 100000, got 0"),
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
