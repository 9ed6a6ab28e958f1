"""Generated arches: sizes, clinical types, ranges of their parameters, recipes, draws."""

import dataclasses
import json

import numpy as np
import pytest

from cathsim.anatomy import Aneurysm, ArchParameters, VesselTree
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import draw_parameters
from cathsim.anatomy.generator.recipe import RANDOM, draw_recipe, recipe_content, recipe_of
from cathsim.anatomy.generator.scan_arch import MINIMUM_SEPARATION, sample_parameters, separation
from cathsim.anatomy.library import NAMED

TYPES = {"type_1": "I", "type_2": "II", "type_3": "III", "type_1_aneurysm": "I", "low_tortuosity": "I", "bovine": "I"}


@pytest.fixture(scope="module")
def trees() -> dict[str, VesselTree]:
    return {name: build_arch(parameters) for name, parameters in NAMED.items()}


@pytest.mark.parametrize("name", NAMED)
def test_arch_type_by_its_clinical_definition(trees, name):
    """The top of the aortic wall over the BCA's ostium: below one diameter of the LCCA I, up to two II, above III."""
    tree = trees[name]
    steepness = np.clip(tree.root.tangents[:, 2], -1, 1)
    top = np.max(tree.root.points[:, 2] + tree.root.radius * np.sqrt(1 - steepness**2))
    drop, ostium = top - tree.ostium("bca")[2], tree.ostium_arc("lcca")
    # The type must not hang on whether the carotid is measured at its origin or beyond its flare.
    at_origin, beyond = (drop / (2 * tree["lcca"].radius_at(ostium + arc)) for arc in (0.0, 0.025))
    for ratio in (at_origin, beyond):
        assert ("I", "II", "III")[np.searchsorted([1.0, 2.0], ratio, side="right")] == TYPES[name]
    assert at_origin == pytest.approx(NAMED[name].apex_ratio, abs=0.2)


def test_the_aorta_tapers_from_root_to_descending_end(trees):
    aorta = trees["type_1"].root
    assert 2 * aorta.radius[-1] == pytest.approx(0.0318, abs=1e-5)
    assert 2 * aorta.radius[0] == pytest.approx(0.0239, abs=1e-5)
    assert np.all(np.diff(aorta.radius) >= -1e-9)


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


def test_measures_that_do_not_join_are_refused_with_advice():
    with pytest.raises(ValueError, match="raise descending_height or ascending_height"):
        build_arch(ArchParameters(arch_width=0.085, ascending_height=0.055))
    with pytest.raises(ValueError, match="bends too tightly"):
        build_arch(ArchParameters(arch_width=0.055, root_diameter=0.042, tortuosity=0.008, ascending_height=0.11))
    with pytest.raises(ValueError, match="too near the aortic root"):
        build_arch(ArchParameters(apex_ratio=4.0, lcca_diameter=0.0135, ascending_height=0.062, arch_width=0.055))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"root_diameter": 31.8}, r"root_diameter must lie in \[0.024, 0.042\] \(m or rad\), got 31.8"),
        ({"apex_ratio": float("nan")}, "apex_ratio must be a finite number"),
        ({"trunk_length": "long"}, "trunk_length must be a number, got 'long'"),
        ({"root_diameter": 0.025, "descending_diameter": 0.030}, "must not exceed root_diameter"),
        ({"winding_seed": -1}, "winding_seed must lie in 0 to"),
    ],
)
def test_impossible_measures_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ArchParameters(**arguments)


def test_impossible_aneurysms_are_refused():
    with pytest.raises(ValueError, match="kind must be one of fusiform, saccular, got 'round'"):
        Aneurysm("round")
    with pytest.raises(ValueError, match="too steep"):
        Aneurysm(length=0.03, bulge=0.012)


def test_draws_follow_the_published_spread():
    rng = np.random.default_rng(0)
    draws = [draw_parameters(rng) for _ in range(600)]
    roots = np.array([d.root_diameter for d in draws])
    assert roots.mean() == pytest.approx(0.0318, abs=6e-4)
    assert roots.std() == pytest.approx(0.003, abs=6e-4)
    assert 0.08 < np.mean([d.bovine for d in draws]) < 0.22
    kinds = {d.aneurysm.kind for d in draws if d.aneurysm}
    assert kinds == {"fusiform", "saccular"}


def test_sampled_arches_keep_their_vessels_apart():
    for seed in range(12):
        tree = build_arch(sample_parameters(np.random.default_rng(seed)))
        assert separation(tree) >= MINIMUM_SEPARATION


@pytest.mark.parametrize("name", RANDOM)
def test_a_recipe_comes_back_from_json(name):
    recipe = draw_recipe(name, 5)
    assert recipe_of(json.loads(json.dumps(recipe_content(recipe)))) == recipe
