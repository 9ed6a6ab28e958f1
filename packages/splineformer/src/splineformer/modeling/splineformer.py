"""SplineFormer as published: patch encoder, tip predictor and autoregressive spline decoder."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from guide3d.setting_kinds import Dropout, Layers, Pixels, Units, settings
from splineformer.modeling.decoder import NextTokens, SplineDecoder
from splineformer.modeling.encoder import PatchEncoder
from splineformer.modeling.image_head import ImageHead, ImageKind
from splineformer.modeling.tip import TipPredictor

STOP = 0.5
FIRST_END = 3  # the sequence may end from this token on


@settings
class SplineFormerSettings:
    """Sizes of the published network.

    Attributes:
        image_px: side of the images it reads.
        patch_px: side of a patch.
        width: of the tokens.
        heads: of attention.
        encoder_layers: how many.
        decoder_layers: how many.
        limit: most tokens of a curve.
        dropout: in training.
        tip_px: side to which the tip predictor averages the images.
    """

    image_px: Pixels = 1024
    patch_px: Pixels = 32
    width: Units = 256
    heads: Units = 8
    encoder_layers: Layers = 6
    decoder_layers: Layers = 6
    limit: Layers = 23
    dropout: Dropout = 0.1
    tip_px: Pixels = 256


class Decoded(NamedTuple):
    """Curves that were decoded."""

    tokens: Tensor  # (B, limit, 3) in network units
    lengths: Tensor  # (B,) tokens of each
    end: Tensor  # (B, limit) probability that the token is the last
    kind: ImageKind
    attention: Tensor | None  # (B, heads, limit, N) of the last layer over the memory


class Taught(NamedTuple):
    """What training looks at: every token predicted from the true ones before it."""

    first: Tensor  # (B, 3) the tip predictor's token
    following: NextTokens  # (B, limit - 1, ...)
    kind: ImageKind


class SplineFormer(nn.Module):
    """Image to spline tokens, one after the other.

    Network units: knots as a share of the curve's length, x and y as a share of the image's side.

    Args:
        settings: sizes.
    """

    def __init__(self, settings: SplineFormerSettings) -> None:
        super().__init__()
        self.settings = s = settings
        self.encoder = PatchEncoder(s.image_px, s.patch_px, s.width, s.encoder_layers, s.heads, s.dropout)
        self.decoder = SplineDecoder(s.width, s.decoder_layers, s.heads, s.limit, s.dropout)
        self.tip = TipPredictor(s.image_px, s.tip_px)
        self.kind = ImageHead(s.width)

    def normalised(self, image: Tensor) -> Tensor:
        """(B, 1, h, w) grey levels of 0 to 255, to -1 to 1."""
        return image / 127.5 - 1.0

    def forward(self, image: Tensor, tokens: Tensor) -> Taught:
        """Teacher forcing.

        Args:
            image: (B, 1, image_px, image_px) grey levels of 0 to 255.
            tokens: (B, limit - 1, 3) true tokens, padded.
        """
        x = self.normalised(image)
        memory = self.encoder(x)
        return Taught(self.tip(x), self.decoder(tokens, memory), self.kind(memory))

    @torch.no_grad()
    def decode(self, image: Tensor, attention: bool = False, memory: Tensor | None = None) -> Decoded:
        """Reads the curves off images; each sequence goes on until its end probability passes one half.

        Args:
            image: (B, 1, image_px, image_px) grey levels of 0 to 255.
            attention: return the last layer's attention, too.
            memory: the encoder's, if it is at hand.
        """
        x = self.normalised(image)
        memory = self.encoder(x) if memory is None else memory
        cache = self.decoder.begin(memory)
        token = self.tip(x)[:, None]
        limit, batch = self.settings.limit, len(image)
        tokens, ends = [token], [token.new_zeros(batch, 1)]
        lengths = torch.full((batch,), limit, device=token.device)
        for number in range(1, limit):
            following = self.decoder.step(token, cache, attention)
            token = following.tokens
            end = torch.sigmoid(following.end)
            tokens.append(token)
            ends.append(end)
            if number + 1 >= FIRST_END:
                lengths = torch.where((end[:, 0] > STOP) & (lengths == limit), number + 1, lengths)
                if bool((lengths < limit).all()):
                    break
        missing = limit - len(tokens)
        every, end = torch.cat(tokens, 1), torch.cat(ends, 1)
        every = torch.cat([every, every[:, -1:].expand(-1, missing, -1)], 1)
        end = torch.cat([end, end[:, -1:].expand(-1, missing)], 1)
        weights = None
        if attention:
            weights = torch.stack(cache.attended, dim=2)
            # the first token comes from the tip predictor: the query that carries it stands for it
            weights = torch.cat([weights[:, :, :1], weights], dim=2)
            weights = torch.cat([weights, weights[:, :, -1:].expand(-1, -1, missing, -1)], dim=2)
        return Decoded(every, lengths, end, self.kind(memory), weights)
