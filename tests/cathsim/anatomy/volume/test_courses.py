"""Courses of labelled vessels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from cathsim.anatomy.volume import courses
from cathsim.anatomy.volume.family import Family


def test_a_stub_that_ends_where_it_begins_has_no_narrow_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(courses, "_way_within", lambda *_: np.array([0]))
    graph: Any = SimpleNamespace(points=np.zeros((1, 3)), depth=np.array([1e-3]))
    stub = courses.Courses(graph, np.ones(1, np.uint8), cast(Family, None), [1], 0, 0)
    places, depth = courses.narrow_places(stub, 1, 0, 0, 1.5e-3)
    assert len(places) == 0
    assert depth == 1.5e-3
