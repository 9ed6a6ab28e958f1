"""The variant of our own: ordered queries find their places along the wire at once, then a walker follows the wire.

Each query stands for a share of the wire's length, from the tip to the end. It attends to a feature map, and its
place is the mean of the map's cells weighted by the attention. Refinements move the points onto the wire. That is the
parallel reading. Where the wire comes in it is exact, and there the walker starts. A fixed linear map, least squares on
fixed knots, turns points into control points.
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
from splineformer.modeling.walker import Steps, Walker, at_shares_of_length

FEWEST_STEPS = 3  # points of a way that counts
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
        detail: channels of the map at 1/2 of the side that refinements and walker look at.
        walker_reach: cells of that map that the walker sees to each side.
        walker_width: of its hidden layers.
        most_steps: of the walker.
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
    detail: int = 24
    walker_reach: int = 4
    walker_width: int = 128
    most_steps: int = 110


class Ordered(NamedTuple):
    """What the parallel network says of images."""

    attention: Tensor  # (B, queries, cells) logits over the fine map, row by row
    wire: Tensor  # (B, cells) logits that wire lies in the cell
    stages: list[Tensor]  # (B, queries, 2) points after the attention and after each refinement, shares of the side
    control: Tensor  # (B, control_points, 2)
    spread: Tensor  # (B, queries) logarithm of the expected distance of each point, shares of the side
    kind: ImageKind
    steps: Steps | None  # of the walker, where it was asked


class Reading(NamedTuple):
    """Curves that were read."""

    control: Tensor  # (B, control_points, 2) of the curve that was chosen
    walked: Tensor  # (B,) whether that is the walker's
    arrived: Tensor  # (B,) whether the walker saw the tip
    support: Tensor  # (B,) mean probability that wire lies under the curve
    said: Ordered
    memory: Tensor  # (B, N, width) of the encoder


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
        self.detail = nn.Sequential(
            convolution(s.channels[0] + s.key_width, s.detail, kernel=1), convolution(s.detail, s.detail)
        )
        cell = 2 / s.image_px
        self.refine = nn.ModuleList(
            Refinement(s.detail, cell, s.reach, s.refinement_width) for _ in range(s.refinements)
        )
        self.walker = Walker(s.detail, cell, s.walker_reach, s.walker_width, s.most_steps)
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

    def _seen(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The memory, the queries' features, the keys, and the detailed map."""
        memory, maps = self.encode(image)
        coarse = memory.transpose(1, 2).unflatten(2, maps[-1].shape[2:])
        keys = self.keys(self.ascent(coarse, [maps[level] for level in self.finer])[-1])
        x = self.queries.expand(len(image), -1, -1)
        for layer in decoder_layers(self.decoder):
            x = layer(x, layer.cross_attention.keys_values(memory), causal=False)
        large = nn.functional.interpolate(keys, scale_factor=self.settings.fine_stride / 2, mode="nearest")
        return memory, x, keys, self.detail(torch.cat([maps[0], large], 1))

    def refined(self, detail: Tensor, points: Tensor) -> list[Tensor]:
        """The points after each refinement."""
        stages = []
        for step in self.refine:
            points = step(detail, points.detach())
            stages.append(points)
        return stages

    def _said(self, seen: tuple[Tensor, Tensor, Tensor, Tensor], steps: Steps | None) -> Ordered:
        memory, x, keys, detail = seen
        attention = self.to_query(x) @ keys.flatten(2)  # scaled by what the linear map learns
        points = torch.softmax(attention, -1) @ self.cells
        stages = [points, *self.refined(detail, points)]
        return Ordered(
            attention,
            self.wire(keys).flatten(1),
            stages,
            self.to_control @ stages[-1],
            self.to_spread(x)[..., 0],
            self.kind(memory),
            steps,
        )

    def forward(self, image: Tensor, places: Tensor | None = None, directions: Tensor | None = None) -> Ordered:
        """Reads images in parallel, and asks the walker at places.

        Args:
            image: (B, 1, image_px, image_px) grey levels of 0 to 255.
            places: (B, K, 2) shares of the side.
            directions: (B, K, 2) unit vectors.
        """
        seen = self._seen(image)
        steps = None if places is None or directions is None else self.walker(seen[-1], places, directions)
        return self._said(seen, steps)

    def seen_and_said(self, image: Tensor) -> tuple[Ordered, Tensor]:
        """What `forward` says, and the detailed map that the walker looks at."""
        seen = self._seen(image)
        return self._said(seen, None), seen[-1]

    @torch.no_grad()
    def read(self, image: Tensor) -> Reading:
        """Reads images, and follows the wire from its end; where that leads nowhere, the parallel points stay."""
        seen = self._seen(image)
        said = self._said(seen, None)
        points = said.stages[-1]
        direction = nn.functional.normalize(points[:, -3] - points[:, -1], dim=-1, eps=1e-9)
        walk = self.walker.walk(seen[-1], points[:, -1], direction)
        long = walk.lengths >= FEWEST_STEPS
        walked = at_shares_of_length(walk.points, walk.lengths, 1.0 - self.shares)
        chosen = torch.where(long[:, None, None], walked, points)
        wire = torch.sigmoid(said.wire).unflatten(1, (1, self.fine_side, self.fine_side))
        under = nn.functional.grid_sample(wire, 2 * chosen[:, None] - 1, align_corners=False, padding_mode="border")
        return Reading(self.to_control @ chosen, long, walk.arrived, under.mean((1, 2, 3)), said, seen[0])

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
