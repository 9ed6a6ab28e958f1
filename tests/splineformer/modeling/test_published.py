"""The published network: sizes, every layer in use, the end of a sequence, the tip predictor."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.build import build, size_of
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import FIRST_END, SplineFormer, SplineFormerSettings
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


@pytest.mark.parametrize(("size", "layers", "width"), [("thesis", 6, 256), ("thesis_large", 10, 512)])
def test_published_sizes(size: str, layers: int, width: int) -> None:
    settings = size_of("published", size)
    assert isinstance(settings, SplineFormerSettings)
    assert (settings.image_px, settings.patch_px, settings.limit, settings.heads) == (1024, 32, 23, 8)
    assert (settings.encoder_layers, settings.decoder_layers, settings.width) == (layers, layers, width)
    with torch.device("meta"):
        model = SplineFormer(settings)
    assert model.encoder.positions.shape == (1024, width)
    # self-attention 4 d² + 4 d, feed-forward 8 d² + 5 d, two norms 4 d
    assert sum(p.numel() for p in model.encoder.layers.parameters()) == layers * (12 * width**2 + 13 * width)


def test_every_encoder_layer_is_used() -> None:
    torch.manual_seed(0)
    model = SplineFormer(SplineFormerSettings(64, 16, 32, 2, 3, 1, dropout=0.0))
    model.encoder(model.normalised(levels(2, 64))).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in model.encoder.layers.parameters() if p.ndim > 1)


@pytest.mark.parametrize(("bias", "expected"), [(20.0, FIRST_END), (-20.0, 23)])
def test_where_the_sequence_ends(bias: float, expected: int) -> None:
    model = network("published")
    torch.nn.init.constant_(model.decoder.end.bias, bias)
    decoded = model.decode(levels(2, 64))
    assert decoded.lengths.tolist() == [expected] * 2
    assert decoded.tokens.shape == (2, 23, 3)
    assert (decoded.tokens >= 0).all()


def test_tip_predictor_starts_where_it_is_told() -> None:
    model = network("published")
    torch.nn.init.zeros_(model.tip.out.weight)
    model.tip.start_at(torch.tensor([0.2, 0.4, 0.6]))
    assert torch.allclose(model.tip(torch.rand(1, 1, 64, 64)), torch.tensor([[0.2, 0.4, 0.6]]), atol=1e-4)
