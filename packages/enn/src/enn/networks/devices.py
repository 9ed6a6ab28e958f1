"""Devices: where a network lives, what its convolutions are computed with, and files that know nothing of either."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import nn
from torch.utils._pytree import tree_map_only


def device_of(module: nn.Module) -> torch.device:
    """The device of a network's weights, or of its buffers; the CPU where it has neither."""
    for tensor in itertools.chain(module.parameters(), module.buffers()):  # no list: it is asked at every step
        return tensor.device
    return torch.device("cpu")


def bfloat16_on_processor() -> torch.autocast:
    """What is computed inside on a processor that has bfloat16 takes it for convolutions and products of matrices.

    Weights and their gradients stay float32. A training step of convolutional networks takes 0.65 of the time. On GPUs
    and on processors without bfloat16 it changes nothing.
    """
    abilities = torch.cpu.get_capabilities()
    has = bool(abilities.get("avx512_bf16") or abilities.get("amx_bf16"))
    return torch.autocast("cpu", torch.bfloat16, enabled=has)


def on_cpu(content: Any) -> Any:
    """The same with every tensor on the CPU, so that a file that was written beside a GPU opens without one.

    Args:
        content: tensors in dictionaries, lists and tuples, beside anything else.
    """
    return tree_map_only(torch.Tensor, lambda tensor: tensor.detach().cpu(), content)


@contextmanager
def seeded(seed: int, device: torch.device | str = "cpu") -> Iterator[None]:
    """Global random numbers from a seed inside, as they were outside; no GPU but the one named is woken.

    Args:
        device: whose generator is put back, beside the CPU's.
    """
    place = torch.device(device)
    with torch.random.fork_rng(devices=[place] if place.type == "cuda" else []):
        torch.manual_seed(seed)
        yield
