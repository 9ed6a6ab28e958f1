"""The autoregressive decoder: the cache, and tokens that see none after them."""

from __future__ import annotations

import numpy as np
import torch

from splineformer.build import build, size_of
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import SplineFormer
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


def test_cache_gives_what_the_whole_sequence_gives() -> None:
    model = network("published")
    assert isinstance(model, SplineFormer)
    tokens, image = torch.rand(2, 9, 3), levels(2, 64)
    memory = model.encoder(model.normalised(image))
    whole = model.decoder(tokens, memory)
    cache = model.decoder.begin(memory)
    steps = [model.decoder.step(tokens[:, k : k + 1], cache) for k in range(9)]
    assert torch.allclose(torch.cat([one.tokens for one in steps], 1), whole.tokens, atol=1e-5)
    assert torch.allclose(torch.cat([one.end for one in steps], 1), whole.end, atol=1e-5)


def test_later_tokens_do_not_change_earlier_ones() -> None:
    model = network("published")
    image, tokens = levels(1, 64), torch.rand(1, 6, 3)
    other = tokens.clone()
    other[:, 4:] += 1
    with torch.no_grad():
        a, b = model(image, tokens).following.tokens, model(image, other).following.tokens
    assert torch.equal(a[:, :4], b[:, :4])
    assert not torch.equal(a[:, 4:], b[:, 4:])
