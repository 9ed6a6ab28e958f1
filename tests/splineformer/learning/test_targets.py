"""Targets: what curves become for each variant, its loss of a perfect prediction, and where training starts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import arc_length
from splineformer.build import VARIANTS, build, size_of
from splineformer.learning.targets import TARGETS, OrderedTargets, PublishedTargets
from tests.splineformer.curves import image_of, wavy_wire

CURVES = [wavy_wire(seed, 1) for seed in range(3)]


def targets_of(variant: str) -> PublishedTargets | OrderedTargets:
    torch.manual_seed(0)
    network = build(size_of(variant, "smoke")).eval()
    made: PublishedTargets | OrderedTargets = TARGETS[variant](network, None, 1024)
    return made


def test_published_targets_are_tokens_in_network_units() -> None:
    targets = targets_of("published")(CURVES, None)
    assert targets["tokens"].shape == (3, 23, 3)
    for tokens, length, curve in zip(targets["tokens"], targets["lengths"], CURVES, strict=True):
        assert tokens[int(length) - 1, 0] == 1.0  # knots are shares of the length
        assert np.allclose(tokens[0, 1:], curve[0], atol=2e-3)  # the first token's point is the tip
        assert torch.equal(tokens[int(length) :], tokens[int(length) - 1].expand(23 - int(length), -1))


def test_ordered_targets_are_points_of_the_curve() -> None:
    made = targets_of("ordered")
    targets = made(CURVES, None)
    queries, steps = made.network.settings.queries, made.network.settings.steps
    assert targets["points"].shape == (3, queries, 2)
    assert targets["course"].shape == (3, steps, 2)
    for number, curve in enumerate(CURVES):
        assert np.allclose(targets["points"][number, [0, -1]], curve[[0, -1]], atol=1e-6)
        assert np.allclose(targets["curve"][number, [0, -1]], curve[[0, -1]], atol=1e-6)
        assert np.allclose(targets["course"][number, 0], curve[-1], atol=1e-6)  # it begins where the wire comes in
        assert targets["length"][number] == pytest.approx(arc_length(curve)[-1] / made.network.step, rel=1e-5)


def test_only_training_draws_starts_that_are_off_the_curve() -> None:
    made = targets_of("ordered")
    plain = made(CURVES, None)
    assert torch.equal(plain["starts"], plain["points"])
    assert not plain["begins"].any()
    drawn, again = (made(CURVES, np.random.default_rng(5)) for _ in range(2))
    assert len(drawn["starts"]) == len(drawn["begins"]) == 2  # two fifths of the batch, at least
    assert torch.equal(drawn["starts"], again["starts"])
    assert not torch.allclose(drawn["starts"], drawn["points"][:2])


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_starts_at_the_mean(variant: str) -> None:
    made = targets_of(variant)
    network = made.network
    images = torch.from_numpy(np.stack([image_of(wavy_wire(k, 64), 64) for k in range(2)]))[:, None].float()
    targets = made([CURVES[0]], None)

    def away() -> float:
        if variant == "published":
            return float((network.decode(images).tokens[:, 0] - targets["tokens"][:, 0]).norm(dim=-1).max())
        return float((network(images).overview - targets["points"]).norm(dim=-1).max())

    before = away()
    made.start(targets)
    assert away() < 0.5 * before
    assert away() < 0.3
