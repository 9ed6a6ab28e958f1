"""The autoregressive decoder: one spline token after the other, from those before it and the encoder's features."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from splineformer.modeling.transformer import Cache, DecoderLayer, LayerCache, decoder_layers, sequence_positions


class NextTokens(NamedTuple):
    """What the decoder's heads predict."""

    tokens: Tensor  # (B, M, 3) knot, x, y, in network units
    end: Tensor  # (B, M) logit that it is the last


class SplineDecoder(nn.Module):
    """Tokens to the tokens that follow them, each from those before it and the encoder's features.

    The knot comes from the hidden state by softplus, the control point from knot and hidden state by softplus, the end
    of the sequence by a logit.
    """

    positions: Tensor

    def __init__(self, width: int, layers: int, heads: int, limit: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.embed = nn.Linear(3, width)
        self.register_buffer("positions", sequence_positions(limit, width), persistent=False)
        self.layers = nn.ModuleList(DecoderLayer(width, heads, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.knot, self.point, self.end = nn.Linear(width, 1), nn.Linear(width + 1, 2), nn.Linear(width, 1)
        for head in (self.knot, self.point):
            nn.init.constant_(head.bias, 0.0)  # softplus(0) = 0.69 lies inside the image

    def heads(self, hidden: Tensor) -> NextTokens:
        """The next token of each (B, M, width) hidden state."""
        hidden = self.norm(hidden)
        knot = F.softplus(self.knot(hidden))
        point = F.softplus(self.point(torch.cat([knot, hidden], dim=-1)))
        return NextTokens(torch.cat([knot, point], dim=-1), self.end(hidden)[..., 0])

    def forward(self, tokens: Tensor, features: Tensor) -> NextTokens:
        """What follows each of the (B, M, 3) tokens, all at once: for training, where all are known."""
        x = self.embed(tokens) + self.positions[: tokens.shape[1]]
        for layer in decoder_layers(self.layers):
            x = layer(x, layer.cross_attention.keys_values(features))
        return self.heads(x)

    def begin(self, features: Tensor) -> Cache:
        """A cache without tokens, with the keys and values of the (B, N, width) features."""
        return Cache([LayerCache(layer.cross_attention.keys_values(features)) for layer in decoder_layers(self.layers)])

    def step(self, token: Tensor, cache: Cache, attention: bool = False) -> NextTokens:
        """What follows one (B, 1, 3) token after those in the cache, which it joins.

        Args:
            cache: of those before; changed.
            attention: keep the last layer's (B, heads, N) weights over the features in the cache.
        """
        x = self.embed(token) + self.positions[cache.length]
        for number, (layer, own) in enumerate(zip(decoder_layers(self.layers), cache.layers, strict=True)):
            wanted = attention and number == len(self.layers) - 1
            x = layer.step(x, own, cache.attended if wanted else None)
        cache.length += 1
        return self.heads(x)
