"""SplineFormer as published: patch encoder, tip predictor and autoregressive spline decoder.

It reads lines instead of grey levels (`line_px`), as otherwise its encoder takes hardly anything from the image.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from guide3d.geometry.polyline import Array
from guide3d.learning.precision import bfloat16_in_training
from guide3d.setting_kinds import Dropout, Layers, Pixels, Units, settings
from splineformer.decoding import uniform_knots
from splineformer.modeling.convolutions import dark_lines
from splineformer.modeling.curve_network import CurveBatch, CurveNetwork, ImageHead, ImageKind
from splineformer.modeling.transformer import (
    Cache,
    DecoderLayer,
    EncoderLayer,
    LayerCache,
    decoder_layers,
    grid_positions,
    plane_positions,
    sequence_positions,
)
from splineformer.tokens import FEWEST_TOKENS, tokens_on_knots

STOP = 0.5
FIRST_END = 3  # the sequence may end from this token on
_TIP_CHANNELS = (16, 32, 64, 128)
_TIP_SIDE = 8  # of the tip predictor's last feature map
_TIP_HIDDEN = 512


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

    def __init__(self, width: int, layers: int, heads: int, limit: int, side: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.embed, self.side = nn.Linear(3, width), side
        self.register_buffer("positions", sequence_positions(limit, width), persistent=False)
        self.layers = nn.ModuleList(DecoderLayer(width, heads, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.knot, self.point, self.end = nn.Linear(width, 1), nn.Linear(width + 1, 2), nn.Linear(width, 1)
        for head in (self.knot, self.point):
            nn.init.constant_(head.bias, 0.0)  # softplus(0) = 0.69 lies inside the image

    def embedded(self, tokens: Tensor) -> Tensor:
        """(B, M, width) of (B, M, 3) tokens: numbers, and places as the encoder's `side` x `side` patches have them."""
        return self.embed(tokens) + plane_positions(tokens[..., 1:] * self.side - 0.5, self.embed.out_features)

    def heads(self, hidden: Tensor) -> NextTokens:
        """The next token of each (B, M, width) hidden state."""
        hidden = self.norm(hidden)
        knot = F.softplus(self.knot(hidden))
        point = F.softplus(self.point(torch.cat([knot, hidden], dim=-1)))
        return NextTokens(torch.cat([knot, point], dim=-1), self.end(hidden)[..., 0])

    def forward(self, tokens: Tensor, features: Tensor) -> NextTokens:
        """What follows each of the (B, M, 3) tokens, all at once: for training, where all are known."""
        x = self.embedded(tokens) + self.positions[: tokens.shape[1]]
        with bfloat16_in_training(self):
            for layer in decoder_layers(self.layers):
                x = layer(x, layer.cross_attention.keys_values(features))
        return self.heads(x.float())

    def begin(self, features: Tensor) -> Cache:
        """A cache without tokens, with the keys and values of the (B, N, width) features."""
        return Cache([LayerCache(layer.cross_attention.keys_values(features)) for layer in decoder_layers(self.layers)])

    def step(self, token: Tensor, cache: Cache, attention: bool = False) -> NextTokens:
        """What follows one (B, 1, 3) token after those in the cache, which it joins.

        Args:
            cache: of those before; changed.
            attention: keep the last layer's (B, heads, N) weights over the features in the cache.
        """
        x = self.embedded(token) + self.positions[cache.length]
        for number, (layer, own) in enumerate(zip(decoder_layers(self.layers), cache.layers, strict=True)):
            attended = attention and number == len(self.layers) - 1
            x = layer.step(x, own, cache.attended if attended else None)
        cache.length += 1
        return self.heads(x)


@settings
class SplineFormerSettings:
    """Sizes of the published network.

    Attributes:
        image_px: side of the images it reads.
        line_px: px to each side of a line that must be brighter than it.
        patch_px: side of a patch; divides `image_px`.
        limit: most tokens of a curve.
        tip_px: side to which the tip predictor averages the images.
    """

    image_px: Pixels
    line_px: Pixels
    patch_px: Pixels = 32
    width: Units = 256
    heads: Units = 8
    encoder_layers: Layers = 6
    decoder_layers: Layers = 6
    limit: Layers = 23
    dropout: Dropout = 0.1
    tip_px: Pixels = 256


class PatchEncoder(nn.Module):
    """Patches to tokens by LayerNorm, a linear map and LayerNorm; sinusoidal positions; then layer after layer."""

    positions: Tensor

    def __init__(self, image_px: int, patch_px: int, width: int, layers: int, heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        if image_px % patch_px:
            raise ValueError(f"patch_px must divide image_px, got {patch_px} and {image_px}")
        self.patch_px, self.side = patch_px, image_px // patch_px
        self.embed = nn.Sequential(nn.LayerNorm(patch_px**2), nn.Linear(patch_px**2, width), nn.LayerNorm(width))
        self.register_buffer("positions", grid_positions(self.side, width), persistent=False)
        self.dropout = nn.Dropout(dropout)
        self.layers = nn.ModuleList(EncoderLayer(width, heads, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 1, image_px, image_px) lines to (B, side², width) features, row by row."""
        p, s = self.patch_px, self.side
        patches = image[:, 0].unflatten(2, (s, p)).unflatten(1, (s, p)).permute(0, 1, 3, 2, 4).flatten(3).flatten(1, 2)
        x = self.dropout(self.embed(patches) + self.positions)
        with bfloat16_in_training(self):
            for layer in self.layers:
                x = layer(x)
        return self.norm(x.float())


class TipPredictor(nn.Module):
    """The first token: convolutions of stride 2, then 512 units, then three numbers by softplus.

    Args:
        seen_px: it is averaged down to this side first; what the convolutions leave is pooled to 8 x 8 cells.
    """

    def __init__(self, image_px: int, seen_px: int) -> None:
        super().__init__()
        self.shrink = max(image_px // seen_px, 1)
        layers: list[nn.Module] = []
        before = 1
        for channels in _TIP_CHANNELS:
            layers += [nn.Conv2d(before, channels, 3, 2, 1), nn.BatchNorm2d(channels), nn.ReLU()]
            before = channels
        self.convolutions = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(_TIP_SIDE))
        self.hidden = nn.Sequential(nn.Flatten(), nn.Linear(before * _TIP_SIDE**2, _TIP_HIDDEN), nn.ReLU())
        self.out = nn.Linear(_TIP_HIDDEN, 3)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 1, h, w) images to (B, 3) knot, x, y of the first token."""
        if self.shrink > 1:
            image = F.avg_pool2d(image, self.shrink)
        with bfloat16_in_training(self):
            hidden = self.hidden(self.convolutions(image))
        token: Tensor = F.softplus(self.out(hidden.float()))
        return token

    @torch.no_grad()
    def start_at(self, token: Tensor) -> None:
        """Sets the last bias so that an untrained network gives this (3,) token."""
        self.out.bias.copy_(torch.log(torch.expm1(token.clamp_min(1e-3))))


class Decoded(NamedTuple):
    """Curves that were decoded."""

    tokens: Tensor  # (B, limit, 3) in network units
    lengths: Tensor  # (B,) tokens of each
    end: Tensor  # (B, limit) probability that the token is the last
    features: Tensor  # (B, N, width) of the encoder
    attention: Tensor | None  # (B, heads, limit, N) of the last layer over the features


class TaughtTokens(NamedTuple):
    """Predictions in training: every token from the true ones before it."""

    first: Tensor  # (B, 3) the tip predictor's token
    following: NextTokens  # (B, limit - 1, ...)
    kind: ImageKind


class SplineFormer(CurveNetwork):
    """Image to spline tokens, one after the other.

    Network units: knots as a share of the curve's length, x and y as a share of the image's side.
    """

    variant: ClassVar[str] = "published"

    def __init__(self, settings: SplineFormerSettings) -> None:
        super().__init__()
        self.settings = s = settings
        self.encoder = PatchEncoder(s.image_px, s.patch_px, s.width, s.encoder_layers, s.heads, s.dropout)
        self.decoder = SplineDecoder(s.width, s.decoder_layers, s.heads, s.limit, self.encoder.side, s.dropout)
        self.tip = TipPredictor(s.image_px, s.tip_px)
        self.kind = ImageHead(s.width)

    @property
    def limit(self) -> int:
        return int(self.settings.limit)

    @property
    def knots(self) -> Array:
        """The (limit + 4,) equal knots in 0 to 1 that it learns: fitted ones jump from image to image."""
        return uniform_knots(self.limit, dtype=torch.float64).numpy()

    def normalised(self, image: Tensor) -> Tensor:
        """(B, 1, h, w) grey levels of 0 to 255 to dark lines: see `splineformer.modeling.convolutions.dark_lines`."""
        return dark_lines(image, self.settings.line_px)

    def forward(self, image: Tensor, tokens: Tensor) -> TaughtTokens:
        """Teacher forcing: (B, 1, image_px, image_px) grey levels of 0 to 255, (B, limit - 1, 3) tokens."""
        x = self.normalised(image)
        features = self.encoder(x)
        return TaughtTokens(self.tip(x), self.decoder(tokens, features), self.kind(features))

    @torch.no_grad()
    def decode(self, image: Tensor, attention: bool = False) -> Decoded:
        """Reads the curves off (B, 1, image_px, image_px) grey levels of 0 to 255.

        Each sequence goes on until its end probability passes one half. With `attention` the last layer's is kept.
        """
        x = self.normalised(image)
        features = self.encoder(x)
        cache = self.decoder.begin(features)
        token = self.tip(x)[:, None]
        limit, batch = self.limit, len(image)
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
        return Decoded(every, lengths, end, features, weights)

    @torch.no_grad()
    def read(self, image: Tensor) -> CurveBatch:
        decoded = self.decode(image)
        quality = decoded.end.gather(1, decoded.lengths[:, None] - 1)[:, 0]
        lengths = decoded.lengths.clamp_min(FEWEST_TOKENS)
        return CurveBatch(decoded.tokens, lengths, decoded.features, self.kind(decoded.features), quality, None)

    def attention(self, image: Tensor) -> tuple[Tensor, Tensor]:
        decoded = self.decode(image, attention=True)
        assert decoded.attention is not None
        return decoded.attention, decoded.lengths

    def fit_tokens(self, points_px: Array) -> Array:
        return tokens_on_knots(points_px, self.knots)
