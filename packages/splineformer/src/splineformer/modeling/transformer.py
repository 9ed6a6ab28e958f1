"""Transformer layers with a key-value cache, and sinusoidal positions in a sequence and on a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor, nn

from guide3d.learning.precision import attention

_LONGEST = 10_000.0  # wavelength of the positions, over 2 pi


def positions(places: Tensor, width: int) -> Tensor:
    """(..., width) sines and cosines of (...) places along a line.

    Source:
        Vaswani et al., Attention Is All You Need (2017), section 3.5.
    """
    rates = torch.exp(torch.arange(0, width, 2, device=places.device) * (-math.log(_LONGEST) / width))
    angles = places[..., None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(-2)[..., :width]


def sequence_positions(count: int, width: int) -> Tensor:
    """(count, width) positions in a sequence."""
    return positions(torch.arange(count), width)


def plane_positions(points: Tensor, width: int) -> Tensor:
    """(..., width) positions of (..., 2) places x, y in cells of a grid: half for the row, half for the column."""
    return torch.cat([positions(points[..., 1], width // 2), positions(points[..., 0], width // 2)], dim=-1)


def grid_positions(side: int, width: int) -> Tensor:
    """(side², width) positions of the cells of a square grid, row by row."""
    if width % 4:
        raise ValueError(f"width must be a multiple of 4, got {width}")
    cells = torch.arange(side)
    return plane_positions(torch.cartesian_prod(cells, cells).flip(1), width)


class Attention(nn.Module):
    """Attention of several heads, which share the width."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"heads must divide the width, got {heads} and {width}")
        self.heads = heads
        self.query, self.key_value = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)

    def keys_values(self, source: Tensor) -> tuple[Tensor, Tensor]:
        """(B, heads, N, width / heads) keys and values of a (B, N, width) source."""
        keys, values = self.key_value(source).chunk(2, dim=-1)
        return self._split(keys), self._split(values)

    def forward(self, x: Tensor, keys_values: tuple[Tensor, Tensor], causal: bool = False) -> Tensor:
        """(B, M, width) answers to the queries x."""
        keys, values = keys_values
        answer = attention(self._split(self.query(x)), keys, values, causal=causal)
        return self.out(answer.transpose(1, 2).flatten(2))

    def weights(self, x: Tensor, keys_values: tuple[Tensor, Tensor]) -> Tensor:
        """(B, heads, M, N) weights that the queries x give to each key; they sum to one over the keys."""
        queries = self._split(self.query(x))
        return torch.softmax(queries @ keys_values[0].transpose(-1, -2) / queries.shape[-1] ** 0.5, dim=-1)


def feed_forward(width: int, dropout: float = 0.0) -> nn.Sequential:
    """Two linear layers with four times the width between them, and GELU."""
    return nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Dropout(dropout), nn.Linear(4 * width, width))


class EncoderLayer(nn.Module):
    """Self-attention and feed-forward, normalised before, added to the input."""

    def __init__(self, width: int, heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.norm_attention, self.norm_forward = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention, self.forward_part = Attention(width, heads), feed_forward(width, dropout)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor) -> Tensor:
        """(B, N, width) to the same."""
        normed = self.norm_attention(x)
        x = x + self.dropout(self.attention(normed, self.attention.keys_values(normed)))
        return x + self.dropout(self.forward_part(self.norm_forward(x)))


@dataclass
class LayerCache:
    """Keys and values a decoder layer has already computed: of the features once, of the tokens so far."""

    features: tuple[Tensor, Tensor]
    tokens: tuple[Tensor, Tensor] | None = None


@dataclass
class Cache:
    """The caches of all layers, and how many tokens have been decoded."""

    layers: list[LayerCache]
    length: int = 0
    attended: list[Tensor] = field(default_factory=list)  # of the last layer, a token each, where asked for


class DecoderLayer(nn.Module):
    """Self-attention over the tokens, cross-attention to the features, feed-forward; each normalised before."""

    def __init__(self, width: int, heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.norm_self, self.norm_cross, self.norm_forward = (nn.LayerNorm(width) for _ in range(3))
        self.self_attention, self.cross_attention = Attention(width, heads), Attention(width, heads)
        self.forward_part = feed_forward(width, dropout)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, features: tuple[Tensor, Tensor], causal: bool = True) -> Tensor:
        """(B, M, width) tokens to the same, all at once.

        Args:
            features: keys and values of the cross-attention.
            causal: a token sees none after it.
        """
        normed = self.norm_self(x)
        x = x + self.dropout(self.self_attention(normed, self.self_attention.keys_values(normed), causal))
        x = x + self.dropout(self.cross_attention(self.norm_cross(x), features))
        return x + self.dropout(self.forward_part(self.norm_forward(x)))

    def step(self, x: Tensor, cache: LayerCache, attended: list[Tensor] | None = None) -> Tensor:
        """One more (B, 1, width) token, whose keys and values join the cache.

        Args:
            cache: of this layer; changed.
            attended: gets the (B, heads, N) weights of the cross-attention.
        """
        normed = self.norm_self(x)
        keys, values = self.self_attention.keys_values(normed)
        if cache.tokens is not None:
            keys, values = torch.cat([cache.tokens[0], keys], 2), torch.cat([cache.tokens[1], values], 2)
        cache.tokens = keys, values
        x = x + self.self_attention(normed, cache.tokens)
        asking = self.norm_cross(x)
        if attended is not None:
            attended.append(self.cross_attention.weights(asking, cache.features)[:, :, 0])
        x = x + self.cross_attention(asking, cache.features)
        return x + self.forward_part(self.norm_forward(x))


def decoder_layers(stack: nn.ModuleList) -> list[DecoderLayer]:
    """The layers of a stack, under their own type."""
    return [cast(DecoderLayer, layer) for layer in stack]
