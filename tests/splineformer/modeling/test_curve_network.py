"""What every variant offers: curves, features, attention and tokens of its own form."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.build import VARIANTS, build, size_of
from splineformer.decoding import decode
from splineformer.modeling.curve_network import CurveBatch, CurveNetwork, ImageKind
from splineformer.tokens import curve_of_tokens, round_trip_px
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str) -> CurveNetwork:
    torch.manual_seed(0)
    return build(size_of(variant, "smoke")).eval()


def levels(count: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, 64), 64, k) for k in range(count)]))[:, None].float()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_batch_is_read(variant: str) -> None:
    model, images = network(variant), levels(3)
    read = model.read(images)
    assert model.variant == variant
    assert read.tokens.shape == (3, model.limit, 3)
    assert ((read.lengths >= 4) & (read.lengths <= model.limit)).all()
    side = round(read.features.shape[1] ** 0.5)
    assert read.features.shape == (3, side**2, model.settings.width)
    assert ((read.quality >= 0) & (read.quality <= 1)).all()
    assert read.kind.wires.shape == (3, 3)
    assert (read.error is None) == (variant == "published")
    assert not read.tokens.requires_grad
    again = model.read(images)
    assert all(torch.equal(a, b) for a, b in zip(read[:3], again[:3], strict=True))
    alone = model.read(images[1:2])
    assert torch.allclose(alone.tokens[0, : int(alone.lengths[0])], read.tokens[1, : int(read.lengths[1])], atol=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_tokens_of_its_own_form(variant: str) -> None:
    model, points = network(variant), wavy_wire(1, 1024)
    tokens = model.fit_tokens(points)
    assert len(tokens) <= model.limit
    assert round_trip_px(points, tokens) < 10
    if variant == "ordered":
        assert len(tokens) == model.limit


@pytest.mark.parametrize("variant", VARIANTS)
def test_attention_is_a_distribution_over_cells(variant: str) -> None:
    model = network(variant)
    weights, lengths = model.attention(levels(2))
    assert weights.shape[:2] == (2, model.settings.heads)
    assert weights.shape[3] == model.read(levels(1)).features.shape[1]
    assert torch.allclose(weights.sum(-1), torch.ones(weights.shape[:3]), atol=1e-5)
    assert ((lengths >= 1) & (lengths <= weights.shape[2])).all()


def batch(tokens: torch.Tensor, lengths: list[int]) -> CurveBatch:
    one = torch.zeros(len(tokens))
    return CurveBatch(tokens, torch.tensor(lengths), one, ImageKind(one, one), one, None)


def test_unit_tokens_have_ascending_knots_to_one_and_repeat_the_last() -> None:
    torch.manual_seed(1)
    tokens = torch.rand(2, 7, 3)
    tokens[0, :, 0] = torch.tensor([-0.2, 0.4, 0.3, 0.8, 2.0, 9.0, 9.0])
    unit = batch(tokens, [5, 7]).unit_tokens()
    assert torch.allclose(unit[0, :, 0], torch.tensor([0.0, 0.2, 0.2, 0.4, 1.0, 1.0, 1.0]))
    assert torch.equal(unit[0, 4:, 1:], tokens[0, 4:5, 1:].expand(3, -1))
    assert torch.equal(unit[1, :, 1:], tokens[1, :, 1:])
    assert torch.allclose(unit[:, -1, 0], torch.ones(2))


def test_unit_tokens_trace_the_same_curve() -> None:
    tokens = torch.from_numpy(network("published").fit_tokens(wavy_wire(2, 1024)))
    unit = batch(tokens[None], [len(tokens)]).unit_tokens()
    points = decode(unit, torch.tensor([len(tokens)]), 50)[0].numpy()
    assert np.abs(points - curve_of_tokens(tokens.numpy()).sample(50)).max() < 1e-2
