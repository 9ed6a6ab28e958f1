"""Episodes in many anatomies, towards many targets, with many wires."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from cathsim import Phantom
from cathsim.environment import NavigateEnv
from cathsim.guidewire import load_guidewire
from cathsim.many_anatomies import NavigateManyEnv, PhantomShelf

FORWARD = np.array([1.0, 0.3])
SOFT = replace(load_guidewire("default"), shaft_stiffness_nmm2=200.0)


@pytest.fixture
def environment(type_1: Phantom) -> NavigateManyEnv:
    wires = ("default", SOFT)
    return NavigateManyEnv((type_1,), ("bca", "lcca"), wires, observation=("roadmap",), start_rotation=np.pi)


def test_draws_every_case_and_repeats_itself(environment: NavigateManyEnv) -> None:
    environment.reset(seed=5)
    drawn = [environment.reset()[1]["case"] for _ in range(24)]
    environment.reset(seed=5)
    assert drawn == [environment.reset()[1]["case"] for _ in range(24)]
    assert set(drawn) == {0, 1, 2, 3}


def test_an_episode_is_that_of_the_single_environment(environment: NavigateManyEnv, type_1: Phantom) -> None:
    start, info = environment.reset(seed=1, options={"case": 3})
    assert (info["case"], info["target"], info["phantom"]) == (3, "lcca", "type_1")
    single = NavigateEnv(type_1, "lcca", wire=SOFT, observation=("roadmap",), start_rotation=np.pi)
    single.reset(options={"start": environment.start_state()[:-1]})
    np.testing.assert_array_equal(single.observe()["roadmap"], start["roadmap"])
    for _ in range(3):
        one, other = environment.step(FORWARD), single.step(FORWARD)
        np.testing.assert_array_equal(one[0]["roadmap"], other[0]["roadmap"])
        assert one[1] == other[1]


def test_a_start_brings_its_case(environment: NavigateManyEnv) -> None:
    environment.reset(seed=1, options={"case": 2})
    for _ in range(5):
        environment.step(FORWARD)
    start, tip = environment.start_state(), environment.simulation.tip
    environment.reset(seed=2, options={"case": 1})
    _, info = environment.reset(options={"start": start})
    assert info["case"] == 2
    np.testing.assert_allclose(info["tip"], tip, atol=1e-12)


def test_the_environment_of_an_earlier_case_leaves_the_memory_at_once(environment: NavigateManyEnv) -> None:
    environment.reset(seed=0, options={"case": 0})
    earlier = weakref.ref(environment.current), weakref.ref(environment.current.simulation)
    gc.disable()
    try:
        environment.reset(seed=0, options={"case": 1})
        assert [one() for one in earlier] == [None, None]
    finally:
        gc.enable()


def test_shelf_forgets_what_was_unused_for_longest(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []

    def load(name: str, *, seed: int | None = None, resolution: float) -> list[object]:
        made.append((name, seed))
        return [name, seed]

    monkeypatch.setattr("cathsim.many_anatomies.load_phantom", load)
    shelf = PhantomShelf(capacity=2)
    first = shelf.take(0, 1e-3)
    shelf.take("type_2", 1e-3)
    assert shelf.take(0, 1e-3) is first
    shelf.take(1, 1e-3)
    assert shelf.take(0, 1e-3) is first
    shelf.take("type_2", 1e-3)
    assert made == [("random", 0), ("type_2", None), ("random", 1), ("type_2", None)]


def test_a_catheter_comes_along_to_every_anatomy() -> None:
    environment = NavigateManyEnv(
        ["type_1", "type_2"], ["bca"], catheter="vertebral", observation="devices", accuracy="fast"
    )
    assert environment.action_space.shape == (4,)
    for case in range(2):
        environment.reset(seed=case, options={"case": case})
        for _ in range(5):
            observation, *_, info = environment.step(np.array([1.0, 0.1, 0.5, -0.2]))
        assert observation.shape == (2, 5)
        assert info["lead"] > 0.003
    with pytest.raises(ValueError, match="neither a wire nor a catheter is there"):
        NavigateManyEnv(["type_1"], ["bca"], wires=[None])
    environment.close()
