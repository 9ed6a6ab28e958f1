"""The hull of a vessel in two views, and the way through it."""

from __future__ import annotations

import numpy as np
import pytest

from enn.imitation.images.visual_hull import VisualHull
from tests.enn.imitation.images.two_views import BRANCH, SIZE, TARGET, TRUNK, VOXELS, lumens


@pytest.fixture(scope="module")
def hull() -> VisualHull:
    return VisualHull(VOXELS, lumens(), TARGET)


def test_the_way_leads_into_the_targets_branch_and_not_into_what_only_overlaps(hull: VisualHull) -> None:
    np.testing.assert_allclose(hull.target, TARGET, atol=1e-6)
    low = np.array([-0.03, 0.02, -0.05])
    points, length = hull.way(low)
    np.testing.assert_allclose(points[[0, -1]], [low, TARGET], atol=1e-9)
    branch, trunk = BRANCH[::20], TRUNK[::20]
    away = np.linalg.norm(points[:, None] - np.concatenate((branch, trunk))[None], axis=2).min(axis=1)
    assert away.max() < 6.5e-3  # within the vessel
    assert length == pytest.approx(0.062 + np.linalg.norm(TARGET - [-0.03, 0.02, 0.01]), rel=0.1)


def test_walls_are_near_across_a_vessel_and_far_along_it(hull: VisualHull) -> None:
    middle = np.array([-0.03, 0.02, -0.02])
    up, across, ahead = hull.walls(middle, np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]))
    assert up == pytest.approx(0.03)  # as far as it looks
    assert 3e-3 < across < 0.02
    assert 3e-3 < ahead < 0.02
    assert hull.walls(np.array([0.05, 0.05, 0.05]), np.eye(3)).max() == 0  # outside


def test_a_way_begins_in_the_nearest_part_of_the_hull(hull: VisualHull) -> None:
    points, length = hull.way(np.array([-0.045, 0.02, -0.05]))
    np.testing.assert_array_equal(points[0], [-0.045, 0.02, -0.05])
    assert length > np.linalg.norm(TARGET - points[0])


def test_without_a_lumen_the_way_is_straight() -> None:
    empty = VisualHull(VOXELS, [np.zeros((SIZE, SIZE))] * 2, TARGET)
    points, length = empty.way(np.zeros(3))
    np.testing.assert_allclose(points, [np.zeros(3), TARGET])
    assert length == pytest.approx(np.linalg.norm(TARGET))
