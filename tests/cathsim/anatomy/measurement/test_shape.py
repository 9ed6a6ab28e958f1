"""Measures of arches: those that they were generated with, angles of a known branch, missing branches."""

import math

import numpy as np
import pytest

from cathsim.anatomy import Phantom, VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.measurement.shape import centreline_curvature, measure_shape, tortuosity


def test_a_generated_arch_is_measured_as_it_was_drawn(phantom) -> None:
    shape, drawn = measure_shape(phantom), phantom.parameters
    assert shape["root_diameter_mm"] == pytest.approx(1e3 * drawn.root_diameter, rel=0.02)
    assert shape["descending_diameter_mm"] == pytest.approx(1e3 * drawn.descending_diameter, rel=0.06)
    assert shape["arch_width_mm"] == pytest.approx(1e3 * drawn.arch_width, rel=0.1)
    assert shape["descending_height_mm"] == pytest.approx(1e3 * drawn.descending_height, rel=0.05)
    assert shape["ellipticity_median"] < 0.01
    assert shape["aorta_roughness_mm"] < 0.05
    assert shape["isthmus_diameter_mm"] < shape["mid_arch_diameter_mm"] < shape["ascending_diameter_mm"]
    assert all(math.isfinite(value) for value in shape.values())


def test_angles_and_missing_branches_of_a_tee(tee: VesselTree) -> None:
    phantom = Phantom("tee", "0", None, tee, build_lumen(tee, resolution=1e-3, fillet_radius=2e-3), {}, {})
    shape = measure_shape(phantom)
    assert shape["bca_takeoff_deg"] == pytest.approx(90, abs=0.1)
    assert shape["bca_aorta_angle_deg"] == pytest.approx(90, abs=0.1)
    assert shape["bca_diameter_mm"] == pytest.approx(8.0, rel=0.03)
    assert math.isnan(shape["lsa_diameter_mm"])
    assert math.isnan(shape["lcca_lsa_spacing_mm"])


def test_tortuosity_and_curvature_of_an_arc() -> None:
    angle = np.linspace(0, np.pi, 100)
    arc = 0.030 * np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    assert tortuosity(arc) == pytest.approx(np.pi / 2 - 1, rel=1e-3)
    assert math.isnan(tortuosity(arc[:10]))
    length = 0.030 * np.pi
    assert centreline_curvature(arc)(np.array([length / 2])) == pytest.approx(1 / 0.030, rel=0.03)
