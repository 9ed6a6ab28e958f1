"""Attention maps: fusion of heads, and both variants."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.attention import attention_map, fused
from splineformer.build import VARIANTS, build, size_of
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import SplineFormer
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


def test_fusion_of_attention() -> None:
    weights = torch.zeros(2, 3, 16)
    weights[0, 1, 5], weights[1, 2, 9], weights[1, 0, 2] = 0.5, 0.02, 0.01
    fusion = fused(weights, 0.6)
    assert fusion.shape == (4, 4)
    assert fusion[1, 1] == 1  # each head counts by its own range
    assert fusion[2, 1] == 1
    assert fusion[0, 2] == 0  # half of the greatest is discarded
    assert fused(weights, 0.4)[0, 2] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="discard"):
        fused(weights, 1.0)
    with pytest.raises(ValueError, match="side²"):
        fused(torch.zeros(2, 3, 15))


@pytest.mark.parametrize("variant", VARIANTS)
def test_attention_map(variant: str) -> None:
    model = network(variant)
    weights, lengths = model.attention(levels(2, 64))
    assert torch.allclose(weights.sum(-1), torch.ones(weights.shape[:3]), atol=1e-5)
    assert (lengths <= weights.shape[2]).all()
    seen = attention_map(model, image_of(wavy_wire(0)))
    assert seen.shape == (256, 256)
    assert 0 <= seen.min() < seen.max() <= 1


def test_attention_map_covers_an_image_that_is_no_square() -> None:
    model = network("ordered")
    image = image_of(wavy_wire(0))
    wide = attention_map(model, image[:128])
    assert wide.shape == (128, 256)
    assert np.array_equal(wide, attention_map(model, image[:128]))
    with pytest.raises(ValueError, match="expected an image of at least 64 x 64 px"):
        attention_map(model, np.zeros((4, 4)))
