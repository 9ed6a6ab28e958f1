"""Sinusoidal positions, of places in a sequence and of cells of a grid."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_LONGEST = 10_000.0


def sequence_positions(count: int, width: int) -> Tensor:
    """(count, width) sines and cosines of the place in a sequence.

    Source:
        Vaswani et al., Attention Is All You Need (2017), section 3.5.
    """
    rates = torch.exp(torch.arange(0, width, 2) * (-math.log(_LONGEST) / width))
    angles = torch.arange(count)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1)[:, :width]


def grid_positions(side: int, width: int) -> Tensor:
    """(side², width) positions of the cells of a square grid, row by row: half for the row, half for the column."""
    if width % 4:
        raise ValueError(f"width must be a multiple of 4, got {width}")
    line = sequence_positions(side, width // 2)
    rows, columns = line[:, None].expand(-1, side, -1), line[None].expand(side, -1, -1)
    return torch.cat([rows, columns], dim=-1).flatten(0, 1)
