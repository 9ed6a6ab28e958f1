"""Convolutions in bfloat16: where the processor has it, and nowhere else."""

from __future__ import annotations

import pytest
import torch

from enn.devices import bfloat16_on_processor


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
