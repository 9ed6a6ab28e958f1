"""Points as targets: their names, that a name is the point again, and points of the branches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cathsim import NavigateEnv, Phantom
from cathsim.anatomy import VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.point_target import as_target, drawn_point_name, points_beyond_root, target_name


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


def test_numbered_points_are_drawn_from_the_branches(type_1: Phantom) -> None:
    places = [type_1.target(drawn_point_name(number)) for number in range(1, 21)]
    assert places[2].name == "point_3"
    assert type_1.target("point_3").position == pytest.approx(places[2].position, abs=0)
    assert {place.branch for place in places} >= {"bca", "lcca"}
    positions = np.stack([place.position for place in places])
    assert len(np.unique(positions, axis=0)) > 15
    assert (type_1.grid.sample(positions) > 1e-3).all()
    drawn = points_beyond_root(type_1.tree, type_1.grid)
    assert all(np.abs(drawn - position).sum(axis=1).min() < 1e-12 for position in positions)
    for name in ("point_0", "point_01", "point_12345", "point_x"):
        with pytest.raises(ValueError, match=f"unknown target '{name}'"):
            type_1.target(name)


def test_another_phantom_has_other_numbered_points(type_1: Phantom) -> None:
    other = replace(type_1, name="type_1_again")
    assert not np.array_equal(other.target("point_1").position, type_1.target("point_1").position)


def test_an_environment_takes_a_numbered_point(type_1: Phantom) -> None:
    environment = NavigateEnv(type_1, "point_2")
    environment.reset(seed=0)
    assert environment.goal == pytest.approx(type_1.target("point_2").position)
    assert environment.task.target_name == "point_2"
    named, point = (type_1.geodesic_field(name) for name in ("point_2", tuple(environment.goal)))
    assert named.sample(environment.goal) == pytest.approx(point.sample(environment.goal))
    environment.close()
