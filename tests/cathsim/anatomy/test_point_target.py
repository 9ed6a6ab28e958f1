"""Points as targets: their names, that a name is the point again, and points of the branches."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import Phantom
from cathsim.anatomy import VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.point_target import as_target, points_beyond_root, target_name


def test_the_name_of_a_point_is_that_point() -> None:
    point = (0.0271, -0.0023, 0.07)
    assert target_name(point) == "point_27.1_-2.3_70.0_mm"
    assert as_target(target_name(point)) == pytest.approx(point)
    assert as_target("point_of_no_return") == "point_of_no_return"


def test_a_phantom_finds_it_by_its_name(type_1: Phantom) -> None:
    place = type_1.target("bca").position.round(4)
    found = type_1.target(target_name(tuple(place.tolist())))
    assert found.position == pytest.approx(place, abs=1e-9)
    assert found.branch == "bca"
    with pytest.raises(ValueError, match="lies outside the lumen"):
        type_1.target("point_500.0_0.0_0.0_mm")
    with pytest.raises(ValueError, match="in metres"):
        as_target("point_50000.0_0.0_0.0_mm")


def test_points_beyond_the_root_lie_on_branches_within_the_lumen(tee: VesselTree) -> None:
    grid = build_lumen(tee, resolution=1e-3, fillet_radius=2e-3)
    points = points_beyond_root(tee, grid)
    assert (points[:, 0] > 0.008).all()  # the root's radius
    assert (np.abs(points[:, 1:]) < 1e-9).all()
    assert (grid.sample(points) > 1e-3).all()
    assert len(points) > 25
