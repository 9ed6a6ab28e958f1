"""Courses of labelled vessels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from cathsim.anatomy.volume.labels.family import Family
from cathsim.anatomy.volume.lumen import courses
from cathsim.anatomy.volume.lumen.courses import narrow_places
from cathsim.anatomy.volume.lumen.graph import LumenGraph


def test_a_stub_that_ends_where_it_begins_has_no_narrow_places() -> None:
    graph: Any = SimpleNamespace(points=np.zeros((1, 3)), depth=np.array([1e-3]), way=lambda *_: np.array([0]))
    stub = courses.Courses(graph, np.ones(1, np.uint8), cast(Family, None), [1], 0, 0)
    places, depth = narrow_places(stub, 1, 0, 0, 1.5e-3)
    assert len(places) == 0
    assert depth == 1.5e-3


@pytest.mark.parametrize("bar", [True, False])
def test_a_bar_to_another_vessel_is_not_a_vessels_end(bar: bool) -> None:
    up = np.arange(60)[:, None] * [0.0, 0.0, 1e-3]  # a vessel of 3 mm of radius, rounded at its end
    aside = up[50] + np.arange(1, 25)[:, None] * [1e-3, 0.0, 0.0]  # a bar of 0.8 mm from 50 mm on
    depth = np.r_[np.full(57, 3e-3), 2e-3, 1e-3, 0.2e-3]
    away: Any = np.arange(60) * 1e-3
    if bar:
        up, depth = np.concatenate([up, aside]), np.r_[depth, np.full(24, 0.8e-3)]
        away = np.r_[away, 50e-3 + np.arange(1, 25) * 1e-3]
    graph = SimpleNamespace(points=up, depth=depth)
    tip, thin = courses._tip(cast(Any, graph), np.arange(len(up)), away, 3e-3, 7.5e-3)
    assert tip == 59
    assert thin == pytest.approx(15e-3 if bar else 0.0)


def test_an_aorta_that_a_branch_parts_keeps_both_its_ends() -> None:
    points = np.arange(41)[:, None] * [0.0, 0.0, 1e-3]
    pairs = np.stack([np.arange(40), np.arange(1, 41)], axis=1)
    depth = np.full(41, 5e-3)
    depth[5] = 9e-3
    graph = LumenGraph(points, depth, np.arange(41), pairs, np.full(40, 1e-3), 1e-3)
    mine = np.ones(41, dtype=np.bool_)
    assert set(courses._far_ends(graph, mine)) == {0, 40}
    mine[18:23] = False  # the nodes of a branch as wide as the aorta is there
    assert set(courses._far_ends(graph, mine)) == {0, 40}
