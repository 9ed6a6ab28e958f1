"""Two calibrated views: epipolar lines, triangulation, and traces matched in order."""

from __future__ import annotations

import numpy as np
import pytest

from enn.imitation.images.stereo_geometry import StereoGeometry, matched
from tests.enn.imitation.images.two_views import FIELD, GEOMETRY, projections, seen


def test_epipolar_lines_pass_through_the_same_point_in_the_other_view_and_points_are_found_again() -> None:
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (20, 3))
    first, second = (seen(points, k)[:, ::-1] for k in (0, 1))
    np.testing.assert_allclose(np.diagonal(GEOMETRY.apart(first, second)), 0, atol=1e-9)
    assert GEOMETRY.apart(first, second[::-1]).mean() > 0.05
    np.testing.assert_allclose(GEOMETRY.triangulated(first, second), points, atol=1e-9)


def test_matches_go_on_alone_only_where_that_is_cheaper() -> None:
    line_of = np.arange(5.0)
    np.testing.assert_array_equal(matched(np.abs(line_of[:, None] - line_of)), np.stack((line_of, line_of), axis=1))
    twice = np.repeat(line_of, 2)
    pairs = matched(np.abs(line_of[:, None] - twice))
    np.testing.assert_array_equal(line_of[pairs[:, 0]], twice[pairs[:, 1]])
    assert pairs[0].tolist() == [0, 0]
    assert pairs[-1, 0] == 4


def test_refuses_what_is_no_geometry_of_two_cameras() -> None:
    with pytest.raises(ValueError, match=r"projections: expected two finite matrices, shape \(2, 3, 4\)"):
        StereoGeometry(projections()[:1], FIELD)
    with pytest.raises(ValueError, match="projections: both cameras have one source"):
        StereoGeometry(projections()[[0, 0]] * np.array([1.0, 2.0])[:, None, None], FIELD)
    for field in (0.0, float("nan"), 1e3):
        with pytest.raises(ValueError, match="field: expected a length of up to 1 m"):
            StereoGeometry(projections(), field)
