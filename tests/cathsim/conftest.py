"""Fixtures of the simulator's tests: phantoms built once into a cache of the test run, and environments on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cathsim import ACCURACY, GUIDEWIRES, NavigateEnv, Phantom, Simulation, load_phantom

MakeEnv = Callable[..., NavigateEnv]
MakeSimulation = Callable[..., Simulation]


@pytest.fixture(scope="session", autouse=True)
def own_cache(anatomy_cache: Path) -> Iterator[None]:
    """Phantoms come from the cache of the test run, also in processes that tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CATHSIM_CACHE", str(anatomy_cache))
        yield


@pytest.fixture
def type_1() -> Phantom:
    return load_phantom("type_1")


@pytest.fixture
def make_env() -> Iterator[MakeEnv]:
    """Makes environments with the fast preset unless told otherwise, and closes them."""
    made: list[NavigateEnv] = []

    def make(**arguments: Any) -> NavigateEnv:
        made.append(NavigateEnv(**{"accuracy": "fast", **arguments}))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def make_simulation(type_1: Phantom) -> MakeSimulation:
    """Makes simulations of a preset wire in the Type I arch with the fast preset, unless told otherwise."""

    def make(wire: str = "default", accuracy: str = "fast", **arguments: Any) -> Simulation:
        numerics = arguments.pop("numerics", ACCURACY[accuracy])
        return Simulation(arguments.pop("phantom", type_1), GUIDEWIRES[wire], numerics, **arguments)

    return make
