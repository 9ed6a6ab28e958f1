"""Products in bfloat16: where the processor has it, in training, and nowhere else; attention stays float32."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from guide3d.learning.precision import attention, bfloat16_in_training, bfloat16_on_processor
from guide3d.modeling.shape_network import FGRN


@pytest.mark.parametrize(
    ("abilities", "expected"),
    [({"avx512_bf16": True}, torch.bfloat16), ({"amx_bf16": True}, torch.bfloat16), ({"avx2": True}, torch.float32)],
)
def test_products_are_bfloat16_where_the_processor_has_it(
    monkeypatch: pytest.MonkeyPatch, abilities: dict[str, bool], expected: torch.dtype
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    layer = torch.nn.Conv2d(1, 4, 3)
    with bfloat16_on_processor():
        found = layer(torch.zeros(2, 1, 8, 8))
    assert found.dtype == expected
    found.float().sum().backward()
    assert layer.weight.dtype == layer.weight.grad.dtype == torch.float32
    assert layer(torch.zeros(2, 1, 8, 8)).dtype == torch.float32  # outside
    with bfloat16_on_processor(False):
        assert layer(torch.zeros(2, 1, 8, 8)).dtype == torch.float32


def test_a_module_is_read_with_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    layer = torch.nn.Linear(8, 8)
    with bfloat16_in_training(layer):
        assert layer(torch.zeros(2, 8)).dtype == torch.bfloat16
    layer.eval()
    with bfloat16_in_training(layer):
        assert layer(torch.zeros(2, 8)).dtype == torch.float32


@pytest.mark.parametrize("causal", [False, True])
def test_attention_is_float32_under_bfloat16(monkeypatch: pytest.MonkeyPatch, causal: bool) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    torch.manual_seed(0)
    query, key, value = (torch.randn(2, 3, 5, 4) for _ in range(3))
    mask = None if causal else torch.randn(1, 3, 5, 5)
    expected = functional.scaled_dot_product_attention(query, key, value, mask, is_causal=causal)
    assert torch.equal(attention(query, key, value, mask, causal=causal), expected)
    with bfloat16_on_processor():
        assert torch.equal(attention(query, key, value, mask, causal=causal), expected)
        rounded = attention(*(x.bfloat16() for x in (query, key, value)), mask, causal=causal)
    assert rounded.dtype == torch.float32
    assert torch.allclose(rounded, expected, atol=0.05)


def test_hidden_layers_alone_are_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(0)
    network, images = FGRN(points=4, image_px=16, filters=(4,), hidden=(8,), dropout=0.0), torch.rand(3, 16, 16)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx2": True})
    exact = network(images)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    rounded = network(images)
    assert rounded.dtype == torch.float32
    assert not torch.equal(rounded, exact)
    assert torch.allclose(rounded, exact, atol=0.02)
    network.eval()
    assert torch.allclose(network(images), exact, atol=1e-6)
