"""Framing: all of a phantom, or a field of fixed size about its arch."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cathsim.anatomy import load_phantom
from cathsim.fluoroscopy import Projector
from cathsim.observations.framing import ABOVE_ARCH, arch_centre, field_projections, framed, raised_bath

FIELD, SIZE = 0.16, 160


@pytest.mark.parametrize("view", ["frontal", "lateral", "lao_45"])
def test_a_millimetre_has_as_many_pixels_in_every_phantom(view: str) -> None:
    for name in ("type_1", "bovine"):
        phantom = load_phantom(name, resolution=2e-3)
        camera, centre = framed(phantom, view, SIZE, FIELD), arch_centre(phantom, FIELD)
        places = camera.project(np.stack([centre, centre + np.array([0.0, 0.0, 0.01])]))
        np.testing.assert_allclose(places[0], (SIZE - 1) / 2, atol=1e-6)
        np.testing.assert_allclose(places[0] - places[1], (0.0, 10.0), atol=1e-6)
        assert camera.name == view


def test_the_arch_lies_where_it_should() -> None:
    phantom = load_phantom("type_1", resolution=2e-3)
    axis = phantom.tree.root.points
    centre = arch_centre(phantom, FIELD)
    assert axis[:, 2].max() - centre[2] == pytest.approx((0.5 - ABOVE_ARCH) * FIELD)
    held = axis[axis[:, 2] > centre[2] - FIELD / 2]
    np.testing.assert_allclose(np.abs(held - centre)[:, :2].max(axis=0), np.ptp(held[:, :2], axis=0) / 2)
    for name in ("bca", "lcca", "lsa"):
        place = framed(phantom, "frontal", SIZE, FIELD).project(phantom.target(name).position[None])[0]
        assert ((place > 0) & (place < SIZE)).all()


def test_the_bath_is_raised_where_the_arch_lies_far_from_the_middle() -> None:
    phantom = load_phantom("type_1", resolution=2e-3)
    assert raised_bath(phantom, FIELD) == 0.0
    bounds = phantom.bounds.copy()
    bounds[0, 2] -= 0.3  # 300 mm of aorta more below
    whole = SimpleNamespace(tree=phantom.tree, bounds=bounds)
    top = bounds[:, 2].mean() + raised_bath(whole, FIELD) + 0.182  # of the water
    assert raised_bath(whole, FIELD) > 0.02
    assert top >= arch_centre(phantom, FIELD)[2] + 1.1 * FIELD / 2


def test_without_a_field_all_of_the_phantom_is_held() -> None:
    phantom = load_phantom("type_1", resolution=2e-3)
    np.testing.assert_array_equal(framed(phantom, "lateral", 96).P, Projector.view("lateral", phantom.bounds, 96).P)


def test_bad_views_and_fields_are_refused() -> None:
    phantom = load_phantom("type_1", resolution=2e-3)
    with pytest.raises(ValueError, match="unknown view 'above'"):
        framed(phantom, "above", 96, FIELD)
    for field in (0.0, -0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="the field of view must be a positive length"):
            framed(phantom, "frontal", 96, field)


def test_views_with_a_field_see_every_arch_by_the_same_matrices() -> None:
    views = ("frontal", "lao_45")
    matrices = field_projections(views, FIELD)
    assert matrices.shape == (2, 3, 4)
    for name in ("type_1", "bovine"):
        phantom = load_phantom(name, resolution=2e-3)
        points = np.stack([phantom.target(target).position for target in ("bca", "lcca", "lsa")])
        about = np.column_stack((points - arch_centre(phantom, FIELD), np.ones(len(points))))
        for view, matrix in zip(views, matrices, strict=True):
            flat = about @ matrix.T
            shares = (framed(phantom, view, SIZE, FIELD).project(points) + 0.5) / SIZE
            np.testing.assert_allclose(flat[:, :2] / flat[:, 2:], shares, atol=1e-9)
    with pytest.raises(ValueError, match="unknown view 'above'"):
        field_projections(("above",), FIELD)
    with pytest.raises(ValueError, match="field of view must be a positive length"):
        field_projections(views, 0.0)
