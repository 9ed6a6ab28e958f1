"""Two calibrated views: epipolar lines, the wire and the way in space, visual hulls."""

import numpy as np
import pytest

from enn.imitation.images.stereo_geometry import StereoGeometry
from enn.imitation.images.stereo_view import CATHETER_SIZE, PARTS, REMAINING_SCALE, STEREO_SIZE, WIRE_ARCS, StereoView
from enn.imitation.images.visual_hull import VisualHull
from enn.imitation.images.wire_tracing import smoothed
from tests.enn.imitation.images.two_views import (
    BRANCH,
    FIELD,
    GEOMETRY,
    TARGET,
    TRUNK,
    VOXELS,
    WIRE,
    lumens,
    projections,
    seen,
)


@pytest.fixture(scope="module")
def view() -> StereoView:
    return StereoView(VOXELS, lumens(), [seen(TARGET[None], k)[0] for k in (0, 1)])


def looked(view: StereoView, wire: np.ndarray) -> dict[str, np.ndarray]:
    """The parts of a look by their names."""
    features = view.look([seen(wire, k) for k in (0, 1)])
    assert features.shape == (STEREO_SIZE,)
    return {name: features[part] for name, part in PARTS.items()}


def test_the_wire_is_found_in_space_in_the_frame_of_its_tip(view: StereoView) -> None:
    parts = looked(view, WIRE)
    assert np.linalg.norm(parts["tip"] * FIELD / 2 - WIRE[0]) < 1e-3
    heading = (WIRE[0] - WIRE[20]) / np.linalg.norm(WIRE[0] - WIRE[20])
    assert heading @ parts["heading"] > 0.995
    towards = np.array([6.0, -4.2, 0.0]) / np.hypot(6.0, 4.2)  # the wire bends from upwards to there
    towards -= (towards @ heading) * heading
    assert towards @ parts["bend"] / np.linalg.norm(towards) > 0.98
    assert 0.3 < parts["sine"][0] < 0.65
    assert parts["missed"][0] < 0.02
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(WIRE, axis=0), axis=1))))
    places = np.stack([np.interp(WIRE_ARCS, arc, WIRE[:, k]) for k in range(3)], axis=1)
    frame = np.stack((np.cross(-parts["bend"], parts["heading"]), -parts["bend"], parts["heading"]), axis=1)
    expected = (places - WIRE[0]) @ frame / WIRE_ARCS[:, None]
    np.testing.assert_allclose(parts["behind"].reshape(7, 3), expected, atol=0.15)
    np.testing.assert_allclose(parts["ahead"].reshape(7, 3), parts["ahead_in_patient"].reshape(7, 3) @ frame, atol=1e-5)


def test_the_way_ahead_leads_to_the_target(view: StereoView) -> None:
    np.testing.assert_allclose(view.hull.target, TARGET, atol=1e-6)
    remaining = looked(view, WIRE)["remaining"][0] * REMAINING_SCALE
    assert remaining == pytest.approx(np.linalg.norm(TARGET - WIRE[0]), rel=0.15)
    directions = looked(view, WIRE)["ahead_in_patient"].reshape(7, 3)[-1]
    assert directions @ (TARGET - WIRE[0]) / np.linalg.norm(TARGET - WIRE[0]) > 0.9


def test_a_catheter_ends_as_far_along_the_wire_as_in_the_views(view: StereoView) -> None:
    axes = [seen(WIRE, k) for k in (0, 1)]
    end = 150  # of the wire's points
    arcs = [float(np.hypot(*np.diff(axis[: end + 1], axis=0).T).sum()) for axis in axes]
    features = view.look(axes, (arcs[0], arcs[1]))
    assert features.shape == (STEREO_SIZE + CATHETER_SIZE,)
    length = np.linalg.norm(np.diff(WIRE[: end + 1], axis=0), axis=1).sum()
    assert features[STEREO_SIZE] * REMAINING_SCALE == pytest.approx(length, abs=1.5e-3)
    assert features[-1] == 1.0
    assert view.look(axes, (9.0, 9.0))[-1] == 0.0


def test_epipolar_lines_pass_through_the_same_point_in_the_other_view_and_points_are_found_again() -> None:
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (20, 3))
    first, second = (seen(points, k)[:, ::-1] for k in (0, 1))
    np.testing.assert_allclose(np.diagonal(GEOMETRY.apart(first, second)), 0, atol=1e-9)
    assert GEOMETRY.apart(first, second[::-1]).mean() > 0.05
    np.testing.assert_allclose(GEOMETRY.triangulated(first, second), points, atol=1e-9)


def test_refuses_what_is_no_geometry_of_two_cameras() -> None:
    with pytest.raises(ValueError, match=r"projections: expected two finite matrices, shape \(2, 3, 4\)"):
        StereoGeometry(projections()[:1], FIELD)
    with pytest.raises(ValueError, match="projections: both cameras have one source"):
        StereoGeometry(projections()[[0, 0]] * np.array([1.0, 2.0])[:, None, None], FIELD)
    for field in (0.0, float("nan"), 1e3):
        with pytest.raises(ValueError, match="field: expected a length of up to 1 m"):
            StereoGeometry(projections(), field)


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


def test_smoothing_keeps_ends_and_straight_lines_and_takes_noise_away() -> None:
    line = np.linspace((0.0, 1.0), (10.0, 6.0), 41)
    np.testing.assert_allclose(smoothed(line, 7), line, atol=1e-12)
    noisy = line + np.random.default_rng(0).normal(0, 0.1, line.shape)
    found = smoothed(noisy, 7)
    np.testing.assert_allclose(found[[0, -1]], noisy[[0, -1]], atol=1e-12)
    assert np.abs(found - line)[3:-3].std() < 0.6 * np.abs(noisy - line)[3:-3].std()
    np.testing.assert_array_equal(smoothed(line[:1], 7), line[:1])
