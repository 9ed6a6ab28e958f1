"""Phantoms: targets, entries, ways along the lumen."""

from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import ArchParameters, Phantom, VesselTree, load_phantom
from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.entry import AHEAD, ENTRY_DEPTH, Entry, end_names, entry_name, read_point
from cathsim.anatomy.geodesic import geodesic_field, graph_distance
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.point_target import as_target, drawn_point_name, points_beyond_root, target_name
from tests.cathsim.anatomy.lumen_report import way_up

COARSE = 2e-3


@pytest.fixture(scope="module")
def fork(tee: VesselTree) -> Phantom:
    """The straight vessel with a side branch, as a phantom."""
    return Phantom(
        name="fork",
        hash="0" * 32,
        parameters=ArchParameters(),
        tree=tee,
        grid=build_lumen(tee, resolution=1e-3, fillet_radius=1e-4),
        targets={},
        entries={"descending": Entry("descending", np.array([0.0, 0.0, -0.038]), np.array([0.0, 0.0, 1.0]))},
    )


def test_way_along_the_centrelines(fork: Phantom, phantom: Phantom) -> None:
    assert fork.way_length("bca_end") == pytest.approx(0.038 + 0.030, abs=1e-6)
    shortest = phantom.geodesic_distance(phantom.entry().position, "lcca_end")
    assert shortest < phantom.way_length("lcca_end") < 1.3 * shortest
    with pytest.raises(ValueError, match=r"unknown target 'lcca_start'.*lcca_end"):
        phantom.way_length("lcca_start")
    with pytest.raises(ValueError, match="unknown entry 'radial'"):
        phantom.way_length("lcca", "radial")


def test_fields_are_computed_when_asked_for_and_written(tmp_path: Path) -> None:
    built = load_phantom("type_2", resolution=COARSE, cache_dir=tmp_path)
    assert len(list(tmp_path.rglob("*.npz"))) == 1
    target = built.target("lsa_end")
    assert built.geodesic_distance(target.position, "lsa_end") < COARSE
    further = target.position - 0.02 * built.tree["lsa"].tangent_at(target.arc)
    assert built.geodesic_distance(further, "lsa_end") == pytest.approx(0.02, abs=1.5 * COARSE)
    assert len(list(tmp_path.rglob("*.npz"))) == 2


def test_targets_at_a_depth_behind_an_ostium(phantom: Phantom) -> None:
    target = phantom.target("rcca@25.5")
    assert (target.branch, target.name) == ("rcca", "rcca@25.5")
    assert target.arc - phantom.tree.ostium_arc("rcca") == pytest.approx(0.0255)
    assert phantom.depths.place(target.position).depth == pytest.approx(0.0255, abs=1e-3)
    with pytest.raises(ValueError, match=r"beyond the end of rcca.*choose rcca@\d+ or nearer"):
        phantom.target("rcca@300")
    with pytest.raises(ValueError, match="unknown target 'lca@20'"):
        phantom.target("lca@20")


def test_dimensions_are_those_of_an_aorta() -> None:
    row = load_phantom("type_1").dimensions()
    assert 80 < row["lumen_volume_ml"] < 300
    assert 20 < row["aorta_diameter_mm"] < 36
    assert row["lcca_diameter_mm"] < row["bca_diameter_mm"] < row["aorta_diameter_mm"]


def test_a_phantom_finds_a_point_by_its_name(type_1: Phantom) -> None:
    place = type_1.target("bca").position.round(4)
    found = type_1.target(target_name(tuple(place.tolist())))
    assert found.position == pytest.approx(place, abs=1e-9)
    assert found.branch == "bca"
    point = (0.0271, -0.0023, 0.07)
    assert target_name(point) == "point_27.1_-2.3_70.0_mm"
    assert as_target(target_name(point)) == pytest.approx(point)
    assert as_target("point_of_no_return") == "point_of_no_return"
    with pytest.raises(ValueError, match="lies outside the lumen"):
        type_1.target("point_500.0_0.0_0.0_mm")
    with pytest.raises(ValueError, match="in metres"):
        as_target("point_50000.0_0.0_0.0_mm")


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


def test_open_end_of_a_branch_leads_into_it(phantom: Phantom) -> None:
    names = end_names(phantom.tree)
    assert set(names) >= {"lcca_end", "lsa_end", "rsa_end", "rcca_end"}
    assert "bca_end" not in names  # others continue it
    for name in names:
        entry, branch = phantom.entry(name), phantom.tree[name.removesuffix("_end")]
        assert np.linalg.norm(entry.position - branch.points[-1]) == pytest.approx(ENTRY_DEPTH, rel=0.01)
        assert np.linalg.norm(entry.direction) == pytest.approx(1.0)
        assert entry.direction @ branch.tangents[-1] < -0.99
        assert phantom.grid.sample(entry.position + AHEAD * entry.direction) > 1.5e-3
        assert phantom.way_length("bca", name) > 0.02


def test_sheath_of_a_point_follows_the_centreline(phantom: Phantom) -> None:
    """Up the aorta, and in a branch down towards it, unless the target lies the other way."""
    aorta, lsa = phantom.tree.root, phantom.tree["lsa"]
    above = aorta.point_at(0.9 * aorta.length)  # between the branches and the heart
    assert phantom.entry(above).direction @ aorta.tangent_at(0.9 * aorta.length) > 0.999
    back = phantom.entry(entry_name(above, "lsa"))
    assert back.direction @ aorta.tangent_at(0.9 * aorta.length) < -0.999
    assert np.array_equal(back.position, above)
    low = phantom.entry(entry_name(tuple(aorta.point_at(0.05)), "lsa"))
    assert low.direction @ aorta.tangent_at(0.05) > 0.999
    within = 0.7 * lsa.length
    place = lsa.point_at(within)
    assert phantom.entry(place).direction @ lsa.tangent_at(within) < -0.999
    assert phantom.entry(entry_name(place, "bca")).direction @ lsa.tangent_at(within) < -0.999
    assert phantom.entry(entry_name(place, "lsa_end")).direction @ lsa.tangent_at(within) > 0.999
    beyond = lsa.point_at(0.9 * lsa.length)
    assert phantom.entry(entry_name(place, beyond)).direction @ lsa.tangent_at(within) > 0.999


def test_text_of_a_point_gives_it_back_exactly() -> None:
    point = tuple(np.random.default_rng(0).uniform(-0.1, 0.1, 3).tolist())
    for target in (None, "lcca", (0.01, -0.02, 0.03)):
        text = entry_name(point, target)
        assert read_point(text) == (point, target)
        assert entry_name(text, "bca") == text
    assert read_point("descending") is None
    assert read_point("(1e-3, 2e-3, 0.1)") == ((1e-3, 2e-3, 0.1), None)


def test_impossible_entries_are_refused(phantom: Phantom) -> None:
    aorta = phantom.tree.root
    near_the_end = aorta.point_at(aorta.length - 2e-3)
    for entry, message in (
        ("bca_end", r"unknown entry 'bca_end'.*choose from descending, ascending, "),
        ((0.5, 0.0, 0.0), r"the entry \(0.5, 0, 0\) m lies outside the lumen .*nearest place inside"),
        ((0.1, 0.2), "an entry is a name, or a point of three coordinates in m"),
        ((12.0, 40.0, 90.0), "an entry's coordinates are in metres"),
        (entry_name(phantom.entry().position, "brain"), "unknown target 'brain'"),
        (near_the_end, "would point at the wall of aorta within 5 mm: move the entry"),
    ):
        with pytest.raises(ValueError, match=message):
            phantom.entry(entry)
    phantom.entry(entry_name(near_the_end, "lcca"))


def test_in_a_straight_tube_it_is_the_straight_distance(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    target = np.array([0.0005, 0.0002, 0.0203])
    field = geodesic_field(grid, target)
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.003, -0.003, -0.027], [0.003, 0.003, 0.027], (400, 3))
    found = field.sample(points)
    assert found == pytest.approx(np.linalg.norm(points - target, axis=1), abs=6e-4)
    with pytest.raises(ValueError, match="must lie inside the lumen, got"):
        geodesic_field(grid, [0.009, 0, 0])


def test_graph_distance_by_hand(tee):
    assert graph_distance(tee, "bca", 0.03, "aorta", 0.01) == pytest.approx(0.03 + 0.03)
    assert graph_distance(tee, "aorta", [0.0, 0.04, 0.08], "bca", 0.02) == pytest.approx([0.06, 0.02, 0.06])
    assert graph_distance(tee, "bca", 0.01, "bca", 0.035) == pytest.approx(0.025)


@pytest.mark.parametrize("target", ["bca", "lcca", "lsa"])
def test_field_agrees_with_the_centreline_graph(phantom, target):
    """Through the lumen it is never longer than along the centreline, and shorter only by what bends allow."""
    place = phantom.targets[target]
    path = way_up(phantom.tree, place.branch, place.arc)
    field = phantom.geodesic_distance(path, target)
    graph = arc_length(path[::-1])[::-1]
    assert np.all(field <= 1.01 * graph + 1e-3)
    assert np.all(field >= 0.75 * graph - 1e-3)
    in_branch = np.linspace(phantom.tree.ostium_arc(target) + 0.006, place.arc, 20)
    points = phantom.tree[target].point_at(in_branch)
    assert phantom.geodesic_distance(points, target) == pytest.approx(place.arc - in_branch, abs=1e-3)
