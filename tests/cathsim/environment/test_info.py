"""The info of a step in the hands of others: vector environments, statistics and recorders need constant shapes."""

import functools
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordStatisticsOfVector

from cathsim import ENVIRONMENT
from cathsim.contact.measured import MAX_CONTACTS
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.registration import MANY
from cathsim.vector import ThreadedManyVectorEnv, ThreadedVectorEnv

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
@pytest.mark.parametrize("further", [{}, {"contact_info": True}, {"drive": "robot"}], ids=str)
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


@pytest.mark.parametrize(("ident", "arguments"), BOTH, ids=IDS)
@pytest.mark.parametrize("mode", ["sync", "async", "vector_entry_point"])
@pytest.mark.parametrize("further", [{"contact_info": True}], ids=str)
def test_vectors_of_every_mode_run_on(
    ident: str, arguments: dict[str, Any], mode: str | None, further: dict[str, Any]
) -> None:
    vector = gymnasium.make_vec(
        f"cathsim:{ident}", 3, vectorization_mode=mode, max_steps=30, success_radius=1e-6, **arguments, **further
    )
    vector = RecordStatisticsOfVector(vector)
    _, infos = vector.reset(seed=0)
    ended = 0
    for _ in range(65):
        _, _, terminated, truncated, infos = vector.step(np.tile(FORWARD, (3, 1)))
        ended += int(np.count_nonzero(terminated | truncated))
        if (terminated | truncated).any():
            assert infos["episode"]["l"].tolist() == [30, 30, 30]
    assert ended == 6
    assert infos["force_vector"].shape == (3, 3)
    if further:
        assert infos["contact_points"].shape == (3, MAX_CONTACTS, 3)
        assert infos["contacts"].shape == (3,)
    if ident == MANY:
        assert infos["target"].dtype == object
        assert set(infos["phantom"]) <= set(MANY_ARGUMENTS["phantoms"])
    vector.close()


def test_the_threaded_vector_of_many_gives_what_its_environments_give_alone() -> None:
    arguments = {**MANY_ARGUMENTS, "observation": "roadmap", "max_steps": 6}
    vector = ThreadedManyVectorEnv(3, threads=2, **arguments)
    alone = [NavigateManyEnv(**arguments) for _ in range(3)]
    together, infos = vector.reset(seed=4)
    for index, env in enumerate(alone):
        observation, info = env.reset(seed=4 + index)
        assert np.array_equal(together[index], observation)
        assert infos["case"][index] == info["case"]
    ended = False
    for _ in range(14):  # two episodes: the cases of the next are drawn alike
        together, *_, infos = vector.step(np.tile(FORWARD, (3, 1)))
        for index, env in enumerate(alone):
            observation, *_, truncated, info = (
                (*env.reset()[:1], 0.0, False, False, {"case": env.case}) if ended else env.step(FORWARD)
            )
            assert np.array_equal(together[index], observation)
            assert infos["case"][index] == info["case"]
        ended = bool(truncated)
    vector.close()


def test_infos_of_endings_have_the_form_of_gymnasiums_vectors() -> None:
    """Also where all environments of a vector end in the same step."""
    arguments: dict[str, Any] = {**FAST, "max_steps": 2}
    ours = ThreadedVectorEnv(2, autoreset_mode="SameStep", **arguments)
    theirs = gymnasium.make_vec(
        ENVIRONMENT,
        2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP},
        **arguments,
    )
    infos = []
    for vector in (ours, theirs):
        vector.reset(seed=0)
        vector.step(np.tile(FORWARD, (2, 1)))
        infos.append(vector.step(np.tile(FORWARD, (2, 1)))[4])
        vector.close()
    mine, other = infos
    assert mine.keys() == other.keys()
    assert mine["final_obs"].dtype == other["final_obs"].dtype == object
    assert np.array_equal(np.stack(list(mine["final_obs"])), np.stack(list(other["final_obs"])))
    for key, value in other["final_info"].items():
        assert np.array_equal(mine["final_info"][key], value), key


@pytest.mark.parametrize(
    ("ident", "arguments", "processes"), [(*BOTH[0], True), (*BOTH[1], False)], ids=["one, subproc", "many, dummy"]
)
def test_vectors_of_stable_baselines(ident: str, arguments: dict[str, Any], processes: bool) -> None:
    vectors = pytest.importorskip("stable_baselines3.common.vec_env")
    maker = functools.partial(make, ident, max_steps=30, success_radius=1e-6, contact_info=True, **arguments)
    vector = vectors.VecMonitor((vectors.SubprocVecEnv if processes else vectors.DummyVecEnv)([maker] * 2))
    vector.reset()
    episodes = []
    for _ in range(60):
        _, _, dones, infos = vector.step(np.tile(FORWARD, (2, 1)))
        episodes += [info["episode"]["l"] for info, done in zip(infos, dones, strict=True) if done]
    vector.close()
    assert episodes == [30] * 4
