"""The stereo view: a wire in a vessel, seen from its tip in two calibrated views."""

from __future__ import annotations

import numpy as np
import pytest

from enn.imitation.images.stereo_view import (
    CATHETER_SIZE,
    PARTS,
    REMAINING_SCALE,
    STEREO_SIZE,
    WIRE_ARCS,
    StereoView,
)
from tests.enn.imitation.images.two_views import (
    FIELD,
    SIZE,
    TARGET,
    VOXELS,
    WIRE,
    line,
    lumens,
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
    empty = StereoView(VOXELS, [nothing, nothing], [seen(TARGET[None], k)[0] for k in (0, 1)])
    unseen = np.array([[0.99, 0.5], [1.0, 0.5]])
    assert np.isfinite(empty.look([unseen, unseen])).all()
    assert np.isfinite(empty.look([seen(WIRE, 0), unseen])).all()
    one_place = np.array([[0.5, 0.5], [0.5, 0.5]])
    assert np.isfinite(empty.look([one_place, one_place], (0.0, 0.0))).all()
