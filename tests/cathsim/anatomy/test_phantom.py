"""Targets at the open ends of branches, and the length of the way there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import PHANTOMS, ArchParameters, Phantom, VesselTree, library, load_phantom
from cathsim.anatomy.entry import Entry
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import locate_end_targets, locate_targets

ENDS = {"rcca_end", "rsa_end", "lcca_end", "lsa_end"}
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


@pytest.mark.parametrize("name", PHANTOMS)
def test_every_phantom_has_targets_10_mm_before_the_open_ends(name: str, cache: Path) -> None:
    phantom = load_phantom(name, resolution=COARSE, cache_dir=cache)
    assert {target.name for target in phantom.targets.values() if target.at_end} == ENDS
    for end in sorted(ENDS):
        target = phantom.target(end)
        branch = phantom.tree[end.removesuffix("_end")]
        assert branch.open_end
        assert target.branch == branch.name
        assert np.linalg.norm(target.position - branch.points[-1]) == pytest.approx(0.010, rel=0.02)
        assert phantom.grid.sample(target.position) > 0.002
        assert phantom.way_length(end) > phantom.way_length(branch.name)


def test_ends_of_an_own_tree(fork: Phantom) -> None:
    assert list(fork.targets) == ["bca_end"], "the root's ends are entries"
    assert fork.target("bca_end").position == pytest.approx([0.030, 0.0, 0.0], abs=1e-9)


def test_a_branch_shorter_than_its_parent_is_wide_has_none(tee: VesselTree) -> None:
    main, side = tee
    stub = type(side)("bca", side.points[:16], side.radius[:16], side.parent, side.parent_arc)
    assert locate_end_targets(VesselTree((main, stub))) == {}


def test_the_usual_targets_are_what_they_were(phantom: Phantom) -> None:
    usual = locate_targets(phantom.tree)
    assert not ENDS & set(usual)
    assert list(phantom.targets)[: len(usual)] == list(usual)


def test_way_along_the_centrelines(fork: Phantom, phantom: Phantom) -> None:
    assert fork.way_length("bca_end") == pytest.approx(0.038 + 0.030, abs=1e-6)
    shortest = phantom.geodesic_distance(phantom.entry().position, "lcca_end")
    assert shortest < phantom.way_length("lcca_end") < 1.3 * shortest
    with pytest.raises(ValueError, match=r"unknown target 'lcca_start'.*lcca_end"):
        phantom.way_length("lcca_start")
    with pytest.raises(ValueError, match="unknown entry 'radial'"):
        phantom.way_length("lcca", "radial")


def test_fields_are_computed_when_asked_for_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load_phantom("type_2", resolution=COARSE, cache_dir=tmp_path)
    assert len(list(tmp_path.rglob("*.npz"))) == 1
    library._load.cache_clear()
    read = load_phantom("type_2", resolution=COARSE, cache_dir=tmp_path)
    target = read.target("lsa_end")
    assert read.geodesic_distance(target.position, "lsa_end") < COARSE
    further = target.position - 0.02 * read.tree["lsa"].tangent_at(target.arc)
    assert read.geodesic_distance(further, "lsa_end") == pytest.approx(0.02, abs=1.5 * COARSE)
    library._load.cache_clear()
    monkeypatch.delattr("cathsim.anatomy.phantom.geodesic_field")  # nothing is computed a second time
    again = load_phantom("type_2", resolution=COARSE, cache_dir=tmp_path)
    assert again.geodesic_distance(further, "lsa_end") == read.geodesic_distance(further, "lsa_end")


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
