"""The two views: drawn once a moment, held while the pedal is up, turned beside the loop."""

from __future__ import annotations

import queue
from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.console.xray.monitor import CArm
from cathsim.console.xray.room import XRayRoom
from cathsim.console.xray.views import Views

MakeEnv = Callable[..., NavigateEnv]
Calls = queue.Queue[tuple[str, Callable[[], None]]]


@pytest.fixture
def calls() -> Calls:
    return queue.Queue()


def test_a_picture_is_drawn_once_a_moment_and_held(make_env: MakeEnv, calls: Calls) -> None:
    env = make_env()
    env.reset(seed=0)
    room = XRayRoom()
    views = Views(room, lambda name, call: calls.put((name, call)), lambda: None)
    views.open(env.simulation)
    wire = env.simulation.wire_points()
    first = views.pictures((0,), wire, None, held=False)
    assert len(first) == 2
    moved = wire + np.array([0.005, 0.0, 0.0])
    assert views.pictures((0,), moved, None, held=False) is first, "the same moment"
    assert views.pictures((1,), moved, None, held=True) is first, "the last image is held"
    later = views.pictures((1,), moved, None, held=False)
    assert later != first
    room.roadmap = True
    assert views.pictures((1,), moved, None, held=False) != later
    views.close()


def test_a_turned_view_is_shown_when_it_is_built(make_env: MakeEnv, calls: Calls) -> None:
    env = make_env()
    env.reset(seed=0)
    turned: list[bool] = []
    views = Views(XRayRoom(), lambda name, call: calls.put((name, call)), lambda: turned.append(True))
    views.open(env.simulation)
    views.turn("a", CArm(primary_deg=30.0))
    name, show = calls.get(timeout=60)
    assert name == "turned a"
    assert views.marks(env.task)["a"]["primary_deg"] == 0.0
    show()
    assert views.marks(env.task)["a"]["primary_deg"] == 30.0
    assert turned == [True]
    views.turn("b", CArm(primary_deg=60.0))
    _, late = calls.get(timeout=60)
    other = make_env()
    other.reset(seed=0)
    views.open(other.simulation)
    late()
    assert turned == [True], "a view of a simulation that is gone is not shown"
    views.close()
