"""The info of a step in the hands of others: vector environments, statistics and recorders need constant shapes."""

import functools
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordStatisticsOfVector

from cathsim import ENVIRONMENT
from cathsim.contact.native import MAX_CONTACTS
from cathsim.registration import MANY

FORWARD = np.array([1.0, 0.3], np.float32)
FAST: dict[str, Any] = {"accuracy": "fast"}
# few phantoms, which the cache of the test run holds already
MANY_ARGUMENTS: dict[str, Any] = {"phantoms": ("type_1", "type_2"), **FAST}
BOTH = [(ENVIRONMENT, FAST), (MANY, MANY_ARGUMENTS)]
IDS = ["one", "many"]


def make(ident: str, **arguments: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(f"cathsim:{ident}", **arguments)


def description(info: dict[str, Any]) -> dict[str, tuple[type, Any, Any]]:
    """Type, shape and kind of numbers of every entry: what Minari's collector compares between steps."""
    return {key: (type(value), np.shape(value), getattr(value, "dtype", None)) for key, value in info.items()}


@pytest.mark.parametrize(("ident", "arguments"), BOTH, ids=IDS)
@pytest.mark.parametrize("further", [{"contact_info": True}, {"drive": "robot"}], ids=str)
def test_info_keeps_its_keys_types_and_shapes(ident: str, arguments: dict[str, Any], further: dict[str, Any]) -> None:
    env = make(ident, **arguments, **further)
    _, info = env.reset(seed=0)
    expected, touched = description(info), False
    for _ in range(2):
        for _ in range(40):
            *_, info = env.step(FORWARD)
            assert description(info) == expected
            touched |= info["force"] > 0
        assert description(env.reset()[1]) == expected
    env.close()
    assert touched or "robot" in further.values(), "contacts came and went"


@pytest.mark.parametrize(
    ("ident", "arguments", "mode"),
    [(*BOTH[0], "sync"), (*BOTH[0], "vector_entry_point"), (*BOTH[1], "async"), (*BOTH[1], "vector_entry_point")],
    ids=["one, sync", "one, threads", "many, async", "many, threads"],
)
def test_vectors_of_every_mode_run_on(ident: str, arguments: dict[str, Any], mode: str) -> None:
    task = {"max_steps": 30, "success_radius": 1e-6, "contact_info": True}
    vector = gymnasium.make_vec(f"cathsim:{ident}", 3, vectorization_mode=mode, **task, **arguments)
    vector = RecordStatisticsOfVector(vector)
    vector.reset(seed=0)
    ended = 0
    for _ in range(65):
        _, _, terminated, truncated, infos = vector.step(np.tile(FORWARD, (3, 1)))
        ended += int(np.count_nonzero(terminated | truncated))
        if (terminated | truncated).any():
            assert infos["episode"]["l"].tolist() == [30, 30, 30]
    assert ended == 6
    assert infos["force_vector"].shape == (3, 3)
    assert infos["contact_points"].shape == (3, MAX_CONTACTS, 3)
    assert infos["contacts"].shape == (3,)
    if ident == MANY:
        assert infos["target"].dtype == object
        assert set(infos["phantom"]) <= set(MANY_ARGUMENTS["phantoms"])
    vector.close()


def test_vectors_of_stable_baselines() -> None:
    vectors = pytest.importorskip("stable_baselines3.common.vec_env")
    maker = functools.partial(make, MANY, max_steps=30, success_radius=1e-6, contact_info=True, **MANY_ARGUMENTS)
    vector = vectors.VecMonitor(vectors.SubprocVecEnv([maker] * 2))
    vector.reset()
    episodes = []
    for _ in range(60):
        _, _, dones, infos = vector.step(np.tile(FORWARD, (2, 1)))
        episodes += [info["episode"]["l"] for info, done in zip(infos, dones, strict=True) if done]
    vector.close()
    assert episodes == [30] * 4
