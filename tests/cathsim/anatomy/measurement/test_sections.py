"""Cross-sections of vessels whose walls are known: diameter, ellipticity, roughness."""

import numpy as np
import pytest

from cathsim.anatomy import Phantom, SignedDistanceGrid, VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.measurement.sections import cut_sections, ostium_place

SPACING = 8e-4


def straight_vessel(tube: VesselTree, across: float, along: float, ripple: float = 0.0) -> Phantom:
    """A vessel along z of two half axes (m), its wall rippled by an amplitude (m) of 5 mm wavelength."""
    axes = [np.arange(-0.014, 0.014, SPACING)] * 2 + [np.arange(-0.036, 0.036, SPACING)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    scale = np.hypot(x, y) / np.maximum(np.hypot(x / across, y / along), 1e-6)
    distance = scale - np.hypot(x, y) + ripple * np.sin(2 * np.pi * z / 5e-3)
    grid = SignedDistanceGrid(np.clip(distance, -0.01, 0.01).astype(np.float32), [axis[0] for axis in axes], SPACING)
    return Phantom("straight", "0", None, tube, grid, {}, {})


def test_an_ellipse_is_measured(tube: VesselTree) -> None:
    sections = cut_sections(straight_vessel(tube, 0.010, 0.008), "aorta")
    assert sections.whole.sum() > 40
    assert sections.diameter[sections.whole] == pytest.approx(2 * np.sqrt(0.010 * 0.008), rel=0.01)
    assert sections.ellipticity[sections.whole] == pytest.approx(0.2, abs=0.01)
    assert sections.diameter_at(0.03) == pytest.approx(2 * np.sqrt(0.010 * 0.008), rel=0.01)


def test_roughness_is_that_of_the_ripple(tube: VesselTree) -> None:
    smooth = cut_sections(straight_vessel(tube, 0.009, 0.009), "aorta").roughness()
    rough = cut_sections(straight_vessel(tube, 0.009, 0.009, ripple=4e-4), "aorta").roughness()
    assert smooth < 3e-5
    assert rough == pytest.approx(4e-4 / np.sqrt(2), rel=0.15)


def test_sections_at_an_ostium_are_not_whole(tee: VesselTree) -> None:
    grid = build_lumen(tee, resolution=1e-3, fillet_radius=2e-3)
    phantom = Phantom("tee", "0", None, tee, grid, {}, {})
    sections = cut_sections(phantom, "aorta")
    place = ostium_place(phantom, "bca")
    assert place == pytest.approx(0.04, abs=1e-3)
    assert not sections.whole[np.abs(sections.arc - place) < 0.006].any()
    assert sections.diameter[sections.whole] == pytest.approx(0.016, rel=0.01)
    branch = cut_sections(phantom, "bca")
    assert branch.arc[0] == pytest.approx(0.008, abs=5e-4)
    assert branch.diameter_at(0.025) == pytest.approx(0.008, rel=0.02)


def test_the_wall_does_not_depend_on_the_resolution(phantom) -> None:
    from cathsim.anatomy.library import build_phantom

    coarse = build_phantom("coarse", phantom.parameters, resolution=2e-3)
    for name in ("aorta", "lsa"):
        fine, other = (cut_sections(one, name) for one in (phantom, coarse))
        both = fine.whole & other.whole
        assert other.diameter[both] == pytest.approx(fine.diameter[both], rel=0.03)
