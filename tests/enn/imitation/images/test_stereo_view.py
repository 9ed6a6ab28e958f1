"""The stereo view: a vessel and a wire in space, drawn in two calibrated views, are found again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import ndimage

from enn.imitation.images.stereo_view import (
    CATHETER_SIZE,
    REMAINING_SCALE,
    STEREO_SIZE,
    WIRE_ARCS,
    StereoGeometry,
    StereoView,
    matched,
)

SIZE, FIELD = 160, 0.16


def projections(angle_deg: float = 45.0) -> np.ndarray:
    """Two cameras 0.8 m from the isocentre, turned about the patient's long axis."""
    matrices = []
    for angle in np.deg2rad((0.0, angle_deg)):
        rotation = np.array([[np.cos(angle), np.sin(angle), 0], [0, 0, -1], [-np.sin(angle), np.cos(angle), 0]])
        camera = np.column_stack((rotation, (0.0, 0.0, 0.8)))
        focal = 0.8 / FIELD
        matrices.append(np.array([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]]) @ camera)
    return np.stack(matrices)


GEOMETRY = StereoGeometry(projections(), FIELD)


def seen(points: np.ndarray, view: int) -> np.ndarray:
    """Rows and columns, shares of the image's side. Shape (n, 2)."""
    flat = np.column_stack((points, np.ones(len(points)))) @ GEOMETRY.projections[view].T
    return (flat[:, :2] / flat[:, 2:])[:, ::-1]


def tube(points: np.ndarray, radius: float, view: int) -> np.ndarray:
    """Its image."""
    image = np.zeros((SIZE, SIZE), bool)
    rows, columns = np.clip((seen(points, view) * SIZE).astype(int), 0, SIZE - 1).T
    image[rows, columns] = True
    return ndimage.distance_transform_edt(~image) <= radius / FIELD * SIZE


def line(*corners: tuple[float, float, float]) -> np.ndarray:
    """Points every 0.2 mm or so along a polyline given in mm."""
    parts = [np.linspace(a, b, 400) for a, b in itertools.pairwise(corners)]
    return np.concatenate(parts) * 1e-3


TRUNK = line((-30, 20, -70), (-30, 20, 30))
BRANCH = line((-30, 20, 10), (35, -25, 40))
BESIDE = line((-30, 20, 20), (-30, -40, 50))  # in the frontal view it lies on the trunk
TARGET = np.array([0.03, -0.0215, 0.0377])
WIRE = line((-27, 17.9, 9), (-30, 20, 4), (-30, 20, -70))  # from the tip on


@pytest.fixture(scope="module")
def view() -> StereoView:
    lumens = [np.any([tube(part, 7e-3, k) for part in (TRUNK, BRANCH, BESIDE)], axis=0).astype(float) for k in (0, 1)]
    return StereoView(GEOMETRY, lumens, [seen(TARGET[None], k)[0] for k in (0, 1)])


def split(features: np.ndarray) -> dict[str, np.ndarray]:
    """The parts of a look by their names."""
    sizes = {"ahead": 21, "there": 21, "remaining": 2, "goal": 4, "behind": 21, "walls": 9, "heading": 3, "bend": 3,
             "sine": 1, "motion": 3, "turn": 3, "tip": 3, "missed": 1}  # fmt: skip
    assert sum(sizes.values()) == STEREO_SIZE
    cuts = np.cumsum(list(sizes.values()))
    return dict(zip(sizes, np.split(features, cuts)[:-1], strict=True))


def looked(view: StereoView, wire: np.ndarray) -> dict[str, np.ndarray]:
    return split(view.look([seen(wire, k) for k in (0, 1)]))


def test_epipolar_lines_pass_through_the_same_point_in_the_other_view_and_points_are_found_again() -> None:
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (20, 3))
    first, second = (seen(points, k)[:, ::-1] for k in (0, 1))
    np.testing.assert_allclose(np.diagonal(GEOMETRY.apart(first, second)), 0, atol=1e-9)
    assert GEOMETRY.apart(first, second[::-1]).mean() > 0.05
    np.testing.assert_allclose(GEOMETRY.triangulated(first, second), points, atol=1e-9)


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
    np.testing.assert_allclose(parts["ahead"].reshape(7, 3), parts["there"].reshape(7, 3) @ frame, atol=1e-5)


def test_the_way_leads_into_the_targets_branch_and_not_into_what_only_overlaps(view: StereoView) -> None:
    np.testing.assert_allclose(view.target, TARGET, atol=1e-6)
    low = np.array([-0.03, 0.02, -0.05])
    points, length = view.way(low)
    np.testing.assert_allclose(points[[0, -1]], [low, TARGET], atol=1e-9)
    branch, trunk = BRANCH[::20], TRUNK[::20]
    away = np.linalg.norm(points[:, None] - np.concatenate((branch, trunk))[None], axis=2).min(axis=1)
    assert away.max() < 6.5e-3  # within the vessel
    assert length == pytest.approx(0.062 + np.linalg.norm(TARGET - [-0.03, 0.02, 0.01]), rel=0.1)
    remaining = looked(view, WIRE)["remaining"][0] * REMAINING_SCALE
    assert remaining == pytest.approx(np.linalg.norm(TARGET - WIRE[0]), rel=0.15)
    directions = looked(view, WIRE)["there"].reshape(7, 3)[-1]
    assert directions @ (TARGET - WIRE[0]) / np.linalg.norm(TARGET - WIRE[0]) > 0.9


def test_walls_are_near_across_a_vessel_and_far_along_it(view: StereoView) -> None:
    straight = line((-30, 20, -20), (-30, 20, -70))
    walls = looked(view, straight)["walls"] * 0.015
    assert walls[0] == pytest.approx(0.03)  # as far as it looks
    assert walls[5:].max() < 0.02
    assert walls[5:].min() > 3e-3


def test_motion_and_turn_of_the_tip_since_the_last_look(view: StereoView) -> None:
    looked(view, WIRE)
    still = looked(view, WIRE)
    np.testing.assert_allclose(still["motion"], 0, atol=1e-6)
    np.testing.assert_allclose(still["turn"], [1, 1, 0], atol=1e-6)
    moved = looked(view, WIRE + np.array([0.0, 0.0, 2e-3]))
    assert np.linalg.norm(moved["motion"]) * 0.01 == pytest.approx(2e-3, rel=0.2)


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


def test_looks_are_finite_where_hardly_anything_is_seen() -> None:
    nothing = np.zeros((SIZE, SIZE))
    empty = StereoView(GEOMETRY, [nothing, nothing], [seen(TARGET[None], k)[0] for k in (0, 1)])
    unseen = np.array([[0.99, 0.5], [1.0, 0.5]])
    assert np.isfinite(empty.look([unseen, unseen])).all()
    assert np.isfinite(empty.look([seen(WIRE, 0), unseen])).all()
    one_place = np.array([[0.5, 0.5], [0.5, 0.5]])
    assert np.isfinite(empty.look([one_place, one_place], (0.0, 0.0))).all()


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
    with pytest.raises(ValueError, match="field: expected a positive length"):
        StereoGeometry(projections(), 0.0)
