"""The parallel variant: ordered queries find their places along the wire at once, and a refinement moves them onto it.

Each query stands for a share of the wire's length, from the tip to the end. It attends to a feature map, and its place
is the mean of the map's cells weighted by the attention. The points then are refined by the features round them and
turned into control points by a fixed linear map, least squares on fixed knots. No token waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from splineformer.decoding import collocation, uniform_knots
from splineformer.modeling.convolutions import Ascent, Stem, convolution, local_contrast
from splineformer.modeling.image_head import ImageHead, ImageKind
from splineformer.modeling.positions import grid_positions
from splineformer.modeling.refinement import Refinement
from splineformer.modeling.transformer import DecoderLayer, EncoderLayer, decoder_layers

_DENSER_AT_TIP = 0.5  # first span of the knots over the mean span: the tip bends most
_STEM_LEVELS = 4


@dataclass(frozen=True)
class OrderedSettings:
    """Sizes of the parallel network.

    Attributes:
        image_px: side of the images it reads.
        channels: of the stem's maps, at 1/2, 1/4, 1/8 and 1/16 of the side.
        blocks: residual blocks of each.
        width: of the tokens of the coarsest map.
        heads: of attention.
        encoder_layers: over the coarsest map.
        decoder_layers: of the queries.
        key_width: of queries and keys of the fine map.
        fine_stride: side of a cell of the fine map, px of the image; 4 or 8.
        queries: points along the wire.
        control_points: of the curve.
        refinements: steps, each with its own weights.
        reach: cells of 1/2 of the resolution that a refinement sees to each side.
        refinement_width: of its hidden layers.
    """

    image_px: int = 256
    channels: tuple[int, ...] = (16, 32, 48, 96)
    blocks: tuple[int, ...] = (0, 1, 1, 0)
    width: int = 96
    heads: int = 4
    encoder_layers: int = 2
    decoder_layers: int = 1
    key_width: int = 32
    fine_stride: int = 4
    queries: int = 32
    control_points: int = 20
    refinements: int = 2
    reach: int = 3
    refinement_width: int = 96


class Ordered(NamedTuple):
    """What the parallel network says of images."""

    attention: Tensor  # (B, queries, cells) logits over the fine map, row by row
    wire: Tensor  # (B, cells) logits that wire lies in the cell
    stages: list[Tensor]  # (B, queries, 2) points after the attention and after each refinement, shares of the side
    control: Tensor  # (B, control_points, 2)
    spread: Tensor  # (B, queries) logarithm of the expected distance of each point, shares of the side
    kind: ImageKind


class OrderedSplineFormer(nn.Module):
    """Image to control points in one pass.

    Args:
        settings: sizes.
    """

    positions: Tensor
    cells: Tensor
    knots: Tensor
    shares: Tensor
    to_control: Tensor

    def __init__(self, settings: OrderedSettings) -> None:
        super().__init__()
        self.settings = s = settings
        if s.image_px % 2**_STEM_LEVELS or len(s.channels) != _STEM_LEVELS or len(s.blocks) != _STEM_LEVELS:
            raise ValueError(
                f"expected {_STEM_LEVELS} channels and blocks and image_px divisible by {2**_STEM_LEVELS}, got {s}"
            )
        if s.fine_stride not in (4, 8):
            raise ValueError(f"fine_stride: expected 4 or 8, got {s.fine_stride}")
        coarse_side, self.fine_side = s.image_px // 16, s.image_px // s.fine_stride
        finer = (2, 1) if s.fine_stride == 4 else (2,)  # levels of the stem on the way up
        self.finer = finer
        self.stem = Stem(2, s.channels, s.blocks)
        self.to_tokens = nn.Linear(s.channels[-1], s.width)
        self.register_buffer("positions", grid_positions(coarse_side, s.width), persistent=False)
        self.encoder = nn.ModuleList(EncoderLayer(s.width, s.heads) for _ in range(s.encoder_layers))
        self.norm = nn.LayerNorm(s.width)
        self.ascent = Ascent(s.width, [s.channels[level] for level in finer])
        narrow = s.channels[finer[-1]]
        self.keys = nn.Sequential(convolution(narrow, s.key_width), nn.Conv2d(s.key_width, s.key_width, 1))
        self.wire = nn.Conv2d(s.key_width, 1, 1)
        self.queries = nn.Parameter(torch.randn(s.queries, s.width) * 0.5)
        self.decoder = nn.ModuleList(DecoderLayer(s.width, s.heads) for _ in range(s.decoder_layers))
        self.to_query = nn.Sequential(nn.LayerNorm(s.width), nn.Linear(s.width, s.key_width))
        self.to_spread = nn.Sequential(nn.LayerNorm(s.width), nn.Linear(s.width, 1))
        fine = s.channels[0] + s.key_width
        self.refine = nn.ModuleList(
            Refinement(fine, 2 / s.image_px, s.reach, s.refinement_width, s.key_width) for _ in range(s.refinements)
        )
        self.refine_reach = (s.reach + 1) * 2 / s.image_px  # share of the side: further off nothing of the wire is seen
        self.kind = ImageHead(s.width)
        centres = (torch.arange(self.fine_side) + 0.5) / self.fine_side
        rows, columns = torch.meshgrid(centres, centres, indexing="ij")
        self.register_buffer("cells", torch.stack([columns, rows], -1).flatten(0, 1), persistent=False)
        knots = uniform_knots(s.control_points, _DENSER_AT_TIP, torch.float64)
        shares = torch.linspace(0, 1, s.queries, dtype=torch.float64)
        shares = shares * (_DENSER_AT_TIP + (1 - _DENSER_AT_TIP) * shares)
        at_queries = collocation(knots, shares)
        self.register_buffer("knots", knots.float(), persistent=False)
        self.register_buffer("shares", shares.float(), persistent=False)  # of the length, where each query lies
        self.register_buffer("to_control", torch.linalg.pinv(at_queries).float(), persistent=False)
        self.side_of_contrast = max(s.image_px // 16, 3) // 2 * 2 + 1

    def normalised(self, image: Tensor) -> Tensor:
        """(B, 1, h, w) grey levels of 0 to 255 to two channels: the levels in -1 to 1, and their local contrast."""
        return torch.cat([image / 127.5 - 1.0, local_contrast(image, self.side_of_contrast)], 1)

    def encode(self, image: Tensor) -> tuple[Tensor, list[Tensor]]:
        """The (B, N, width) memory and the stem's maps."""
        maps = self.stem(self.normalised(image))
        x = self.to_tokens(maps[-1].flatten(2).transpose(1, 2)) + self.positions
        for layer in self.encoder:
            x = layer(x)
        return self.norm(x), maps

    def forward(self, image: Tensor) -> Ordered:
        """Reads (B, 1, image_px, image_px) images with grey levels of 0 to 255."""
        memory, maps = self.encode(image)
        coarse = memory.transpose(1, 2).unflatten(2, maps[-1].shape[2:])
        fine = self.ascent(coarse, [maps[level] for level in self.finer])[-1]
        keys = self.keys(fine)
        x = self.queries.expand(len(image), -1, -1)
        for layer in decoder_layers(self.decoder):
            x = layer(x, layer.cross_attention.keys_values(memory), causal=False)
        query = self.to_query(x)
        attention = query @ keys.flatten(2)  # scaled by what the linear map learns
        stages = [torch.softmax(attention, -1) @ self.cells]
        detail = torch.cat(
            [maps[0], nn.functional.interpolate(keys, scale_factor=self.settings.fine_stride / 2, mode="nearest")], 1
        )
        for step in self.refine:
            stages.append(step(detail, stages[-1].detach(), query))
        return Ordered(
            attention,
            self.wire(keys).flatten(1),
            stages,
            self.to_control @ stages[-1],
            self.to_spread(x)[..., 0],
            self.kind(memory),
        )

    def memory_attention(self, image: Tensor) -> Tensor:
        """(B, heads, queries, N) weights of the last decoder layer over the memory, for pictures of attention."""
        memory, _ = self.encode(image)
        x = self.queries.expand(len(image), -1, -1)
        for layer in decoder_layers(self.decoder)[:-1]:
            x = layer(x, layer.cross_attention.keys_values(memory), causal=False)
        last = decoder_layers(self.decoder)[-1]
        normed = last.norm_self(x)
        x = x + last.self_attention(normed, last.self_attention.keys_values(normed))
        return last.cross_attention.weights(last.norm_cross(x), last.cross_attention.keys_values(memory))
