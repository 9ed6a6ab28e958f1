"""Arch parameters: ranges, messages, random draws."""

import numpy as np
import pytest

from cathsim.anatomy import Aneurysm, ArchParameters, Branch, VesselTree
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import draw_parameters
from cathsim.anatomy.generator.scan_arch import MINIMUM_SEPARATION, sample_parameters, separation


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


def test_a_seed_draws_one_arch_and_another_seed_another():
    first, again, other = (sample_parameters(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first == again
    assert first != other


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


def test_separation_sees_vessels_that_touch(tee):
    near = Branch("lcca", tee["bca"].points + np.array([0, 0, 0.009]), np.full(41, 0.004), "aorta", 0.049)
    assert separation(VesselTree((*tee, near))) == pytest.approx(0.001, abs=1e-5)
