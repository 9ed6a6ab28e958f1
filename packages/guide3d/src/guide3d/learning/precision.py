"""Precision: convolutions and products of matrices in bfloat16 where the processor multiplies it by itself."""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager

import torch
from torch import Tensor, nn
from torch.nn import functional


def has_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 by itself; others do it more slowly than float32."""
    abilities = torch.cpu.get_capabilities()
    return bool(abilities.get("avx512_bf16") or abilities.get("amx_bf16"))


def bfloat16_on_processor(enabled: bool = True) -> torch.autocast:
    """What is computed inside on a processor that has bfloat16 takes it for convolutions and products of matrices.

    Weights and their gradients stay float32. A training step of convolutional networks takes 0.65 to 0.7 of the time,
    of the shape network and the ordered SplineFormer, whose attention is `attention`, 0.6 and 0.8. Group normalisation
    in bfloat16 may cost more than is won. On a GPU it changes nothing.
    """
    return torch.autocast("cpu", torch.bfloat16, enabled=enabled and has_bfloat16())


def bfloat16_in_training(module: nn.Module) -> AbstractContextManager[object]:
    """`bfloat16_on_processor` for a module's hidden layers while it is trained; when it is read with, as before.

    What layers of coordinates give has to be computed outside: bfloat16 keeps three digits.
    """
    return bfloat16_on_processor() if module.training else contextlib.nullcontext()


def attention(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None = None, *, causal: bool = False) -> Tensor:
    """Attention by scaled products, on a processor in float32: its way back in bfloat16 takes five times as long.

    Args:
        query: (..., M, width); key and value: (..., N, width).
        mask: added to the logits, or None.
        causal: each query sees the keys up to its own place.
    """
    if query.device.type != "cpu" or not torch.is_autocast_enabled("cpu"):
        mask = mask if mask is None else mask.to(query.dtype)
        return functional.scaled_dot_product_attention(query, key, value, mask, is_causal=causal)
    with torch.autocast("cpu", enabled=False):
        return functional.scaled_dot_product_attention(
            query.float(), key.float(), value.float(), mask if mask is None else mask.float(), is_causal=causal
        )
