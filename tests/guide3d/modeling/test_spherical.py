"""Spherical form: round trips through steps and angles, curves that wind, gradients, and what is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from guide3d.modeling.spherical import SphericalForm, steps_of_radius
from tests.guide3d.learning.drawn_data import wire


def test_steps_have_the_radius_and_lie_on_the_curve() -> None:
    curve = wire(0.3, 10.0)
    walk = steps_of_radius(curve, 1.7)
    assert np.linalg.norm(np.diff(walk, axis=0), axis=1) == pytest.approx(1.7, abs=1e-3)
    dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(curve)])
    assert np.linalg.norm(walk[:, None] - dense[None], axis=-1).min(axis=1).max() < 0.05
    assert np.array_equal(walk[0], curve[0])
    with pytest.raises(ValueError, match="a curve of at least 500 mm"):
        steps_of_radius(curve, 500)


@pytest.mark.parametrize("cumulative", [False, True])
def test_angles_give_the_walk_again(cumulative: bool) -> None:
    walks = [steps_of_radius(wire(turn, 10.0), 2.0) for turn in np.linspace(-3, 3, 9)]  # all round
    form = SphericalForm.fit(walks, 2.0, cumulative=cumulative)
    for walk in walks:
        offsets = form.encode(walk)
        again = form.decode(torch.from_numpy(walk[0]), torch.from_numpy(offsets)).numpy()
        assert np.abs(again - walk).max() < 1e-3 * len(walk)
        steps = offsets if not cumulative else np.cumsum(offsets, axis=0)
        assert np.abs(np.diff(steps[:, 0])).max() < 0.5  # unwrapped along the curve


def test_axes_are_right_handed_and_their_pole_is_avoided() -> None:
    walks = [steps_of_radius(wire(turn, 10.0), 2.0) for turn in (-0.2, 0.0, 0.2)]
    form = SphericalForm.fit(walks, 2.0)
    axes = np.array(form.axes)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    steps = np.concatenate([np.diff(walk, axis=0) for walk in walks]) / 2.0
    assert np.abs(steps @ axes[2]).max() < np.cos(np.radians(20))
    assert np.abs(np.concatenate([form.encode(walk)[-1:, 0] for walk in walks])).max() < np.pi / 2  # far from the cut


def test_gradients_reach_every_angle() -> None:
    form = SphericalForm.fit([steps_of_radius(wire(0.0, 10.0), 2.0)], 2.0, cumulative=True)
    offsets = torch.zeros(4, 9, 2, dtype=torch.float64, requires_grad=True)
    tip = torch.zeros(4, 3, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: form.decode(tip, x), (offsets + 0.3 * torch.rand_like(offsets),))
