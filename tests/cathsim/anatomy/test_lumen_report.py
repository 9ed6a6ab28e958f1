"""The lumen check: sound phantoms pass, damaged ones are named."""

import dataclasses

import numpy as np
import pytest

from cathsim.anatomy import SignedDistanceGrid
from cathsim.anatomy.generator.scan_arch import sample_parameters
from cathsim.anatomy.library import NAMED, build_phantom
from tests.cathsim.anatomy.lumen_report import check_lumen


def _changed(phantom, change):
    values = phantom.grid.values.copy()
    height = phantom.grid.coordinates(np.argwhere(np.ones(values.shape, bool)))[:, 2].reshape(values.shape)
    change(values, height)
    grid = SignedDistanceGrid(values, phantom.grid.origin, phantom.grid.spacing)
    return dataclasses.replace(phantom, grid=grid)


@pytest.mark.parametrize("name", NAMED)
def test_every_named_phantom_is_valid(name):
    report = check_lumen(build_phantom(name, NAMED[name], resolution=1.2e-3))
    assert report.valid, report.problems
    assert set(report.reachable) >= {"bca", "lcca", "lsa", "rcca", "rsa", "rcca_end", "rsa_end", "lcca_end", "lsa_end"}


def test_random_phantoms_are_valid():
    for seed in range(6):
        parameters = sample_parameters(np.random.default_rng(1000 + seed))
        report = check_lumen(build_phantom("random", parameters, resolution=1.2e-3))
        assert report.valid, (seed, report.problems)


def test_the_least_radius_is_that_of_the_vessels(phantom):
    report = check_lumen(phantom)
    target = phantom.targets["lcca"]
    carotid = phantom.tree["lcca"]
    assert report.least_radius["lcca"] == pytest.approx(carotid.radius_at(np.linspace(0, target.arc)).min(), abs=3e-4)


def test_a_blocked_aorta_is_found(phantom):
    def block(values, height):
        values[(height > -0.06) & (height < -0.055)] = -1e-3

    report = check_lumen(_changed(phantom, block))
    assert not report.valid
    assert report.components > 1
    assert not any(report.reachable.values())
    assert any("target bca cannot be reached" in problem for problem in report.problems)


def test_a_narrow_carotid_is_found(phantom):
    ostium = phantom.tree.ostium("lcca")[2]

    def narrow(values, height):
        values[(height > ostium + 0.02) & (height < ostium + 0.03)] -= 2.2e-3

    report = check_lumen(_changed(phantom, narrow))
    assert report.least_radius["lcca"] < 1.9e-3
    assert any("the way to lcca narrows to" in problem for problem in report.problems)


def test_a_closed_end_is_found(phantom):
    bottom = phantom.bounds[0, 2]

    def close(values, height):
        values[height < bottom + 8e-3] = -1e-3

    report = check_lumen(_changed(phantom, close))
    assert report.open_ends == {"descending": False, "ascending": True}
