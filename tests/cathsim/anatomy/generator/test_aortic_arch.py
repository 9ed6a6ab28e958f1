"""The arch generator: sizes, clinical type, shape, variants."""

import dataclasses
import math

import numpy as np
import pytest

from cathsim.anatomy import Aneurysm, ArchParameters, VesselTree
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.library import NAMED
from cathsim.anatomy.lumen import build_lumen
from tests.cathsim.anatomy.generator.arch_type import arch_type, measure_arch

TYPES = {
    "type_1": "I",
    "type_2": "II",
    "type_3": "III",
    "type_1_aneurysm": "I",
    "low_tortuosity": "I",
    "bovine": "I",
}


@pytest.fixture(scope="module")
def trees() -> dict[str, VesselTree]:
    return {name: build_arch(parameters) for name, parameters in NAMED.items()}


def test_every_named_arch_has_the_textbook_branches(trees):
    for tree in trees.values():
        assert tree.names == ("aorta", "bca", "rsa", "rcca", "lcca", "lsa")
        assert (tree["rsa"].parent, tree["rcca"].parent, tree["bca"].parent) == ("bca", "bca", "aorta")


@pytest.mark.parametrize("name", NAMED)
def test_arch_type_by_its_clinical_definition(trees, name):
    measures = measure_arch(trees[name])
    assert measures.type == TYPES[name]
    # The type must not hang on whether the carotid is measured at its origin or beyond its flare.
    assert arch_type(measures.drop / measures.lcca_diameter) == TYPES[name]
    assert measures.ratio == pytest.approx(NAMED[name].apex_ratio, abs=0.2)


@pytest.mark.parametrize("name", ["type_1", "type_2", "type_3"])
def test_arch_type_measured_on_the_built_lumen(trees, name):
    """The aorta's own lumen gives the apex and, where the trunk's centreline leaves it, the origin."""
    tree = trees[name]
    aorta = build_lumen(VesselTree((tree.root,)), resolution=1e-3, fillet_radius=2.5e-3)
    inside = np.argwhere(aorta.values > 0)
    apex = aorta.coordinates(inside)[:, 2].max()
    trunk = tree["bca"].point_at(np.linspace(0, tree["bca"].length, 2000))
    origin = trunk[np.flatnonzero(aorta.sample(trunk) < 0)[0]]
    ratio = (apex - origin[2]) / NAMED[name].lcca_diameter
    assert arch_type(ratio) == TYPES[name]
    assert ratio == pytest.approx(measure_arch(tree).ratio, abs=0.15)


def test_arch_type_borders():
    assert [arch_type(r) for r in (0.0, 0.99, 1.0, 1.99, 2.0, 5.0)] == ["I", "I", "II", "II", "III", "III"]


def test_the_aorta_tapers_from_root_to_descending_end(trees):
    aorta = trees["type_1"].root
    assert 2 * aorta.radius[-1] == pytest.approx(0.0318, abs=1e-5)
    assert 2 * aorta.radius[0] == pytest.approx(0.0239, abs=1e-5)
    assert np.all(np.diff(aorta.radius) >= -1e-9)


def test_the_wire_enters_along_a_straight_stretch(trees):
    for tree in trees.values():
        aorta = tree.root
        entry = aorta.point_at(np.linspace(0, 0.015, 16))
        chord = (entry[-1] - entry[0]) / np.linalg.norm(entry[-1] - entry[0])
        aside = entry - entry[0] - np.outer((entry - entry[0]) @ chord, chord)
        assert np.linalg.norm(aside, axis=1).max() < 5e-5
        assert chord == pytest.approx([0, 0, 1], abs=0.02)


def test_branches_leave_in_order_and_run_up(trees):
    for tree in trees.values():
        bca, lcca, lsa = (tree.ostium(name) for name in ("bca", "lcca", "lsa"))
        assert bca[0] < lcca[0] < lsa[0], "from the patient's right to the left"
        for name in ("bca", "lcca", "rcca", "lsa"):
            branch = tree[name]
            assert branch.points[-1, 2] - branch.points[0, 2] > 0.03
        trunk = tree["bca"].length - tree.ostium_arc("bca")
        assert 0.034 <= trunk <= 0.046
        assert tree["lcca"].length - tree.ostium_arc("lcca") >= 0.080
        assert trunk + tree["rcca"].length >= 0.080
        assert tree["rsa"].points[-1, 0] < tree["bca"].points[-1, 0] - 0.02, "to the patient's right"
        assert tree["lsa"].points[-1, 0] > tree["lsa"].points[0, 0] + 0.02, "to the patient's left"


def test_the_arch_is_no_planar_tube(trees):
    aorta = trees["type_1"].root.points
    spread = np.linalg.svd(aorta - aorta.mean(axis=0), compute_uv=False) / math.sqrt(len(aorta))
    assert spread[2] > 1e-3
    low = trees["low_tortuosity"].root.points
    spread_low = np.linalg.svd(low - low.mean(axis=0), compute_uv=False) / math.sqrt(len(low))
    assert spread_low[2] < spread[2]


def test_sizes_and_centring(trees):
    for tree in trees.values():
        low = np.min([b.points.min(axis=0) for b in tree], axis=0)
        high = np.max([b.points.max(axis=0) for b in tree], axis=0)
        assert np.all(high - low < [0.135, 0.095, 0.245])
        assert np.all(high - low > [0.085, 0.040, 0.190])
        assert np.abs(low + high).max() / 2 < 0.02


def test_the_common_origin_of_a_bovine_arch(trees):
    tree = trees["bovine"]
    assert tree["lcca"].parent == "bca"
    assert tree["lcca"].parent_arc < tree.ostium_arc("bca") + 0.015


def test_fusiform_and_saccular_aneurysms_widen_the_lumen(trees):
    plain = trees["type_1"].root
    fusiform = build_arch(dataclasses.replace(NAMED["type_1"], aneurysm=Aneurysm("fusiform", bulge=0.009)))
    assert np.max(fusiform.root.radius - plain.radius) == pytest.approx(0.009, abs=2e-4)
    saccular = build_arch(dataclasses.replace(NAMED["type_1"], aneurysm=Aneurysm("saccular", bulge=0.009)))
    assert saccular["sac"].parent == "aorta"
    dome = saccular["sac"].point_at(1.0)
    reach = np.linalg.norm(dome - saccular["sac"].points[0]) + saccular["sac"].radius[-1]
    wall = saccular.root.radius_at(saccular["sac"].parent_arc)
    assert reach - wall == pytest.approx(0.009, abs=1e-4)


def test_same_parameters_same_tree_and_other_windings_another():
    first, again = build_arch(ArchParameters()), build_arch(ArchParameters())
    other = build_arch(ArchParameters(winding_seed=9))
    assert all(np.array_equal(a.points, b.points) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first["lcca"].points, other["lcca"].points)


def test_measures_that_do_not_join_are_refused_with_advice():
    with pytest.raises(ValueError, match="raise descending_height or ascending_height"):
        build_arch(ArchParameters(arch_width=0.085, ascending_height=0.055))
    with pytest.raises(ValueError, match="bends too tightly"):
        build_arch(ArchParameters(arch_width=0.055, root_diameter=0.042, tortuosity=0.008, ascending_height=0.11))
    with pytest.raises(ValueError, match="too near the aortic root"):
        build_arch(ArchParameters(apex_ratio=4.0, lcca_diameter=0.0135, ascending_height=0.062, arch_width=0.055))
