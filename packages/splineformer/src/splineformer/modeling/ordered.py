"""The variant of our own: the whole curve at once from the whole picture, then its tip and its course from near by.

An overview predicts the whole course of the wire at once: how it runs through its loops is known only from the whole
image. The features are joined for that, so that places stay places, and each point's own query adds to it. The course
is counted from where the wire comes in, in equal steps, for there the wires of a patient run alike whatever their
length; the length is predicted beside it. Then the points attend to each other and go to their own places, a heat map
finds the tip near by, and refinements move the points onto the wire, coarse ones first. A fixed linear map, least
squares on fixed knots, turns points into control points.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, NamedTuple, cast

import torch
from annotated_types import Interval
from torch import Tensor, nn

from guide3d.geometry.polyline import Array
from guide3d.learning.precision import bfloat16_in_training
from guide3d.setting_kinds import Layers, LayersOrNone, PixelDistance, Pixels, Positive, Units, settings
from splineformer.decoding import collocation, uniform_knots
from splineformer.modeling.convolutions import CHANNELS, FLOOR, Stem, line_pyramid
from splineformer.modeling.curve_network import CurveBatch, CurveNetwork, ImageHead, ImageKind
from splineformer.modeling.refinement import Refinement, Revision, TipMap, TipSeen, at_equal_shares, led_to
from splineformer.modeling.transformer import DecoderLayer, EncoderLayer, decoder_layers, grid_positions
from splineformer.tokens import FEWEST_TOKENS, tokens_on_knots

_STEPS = 10.0  # of the course: unit of what the length's layer gives
_DENSER_AT_TIP = 0.5  # first span of the knots over the mean span: the tip bends most


@settings
class OrderedSettings:
    """Sizes of the ordered network.

    Attributes:
        image_px: side of the pictures it reads.
        overview_level: how often the picture is halved before the stem sees it.
        line_px: to each side of a line, px of the picture.
        floor: grey levels; contrast and lines are in units of four times their mean over the picture, and of four times
            the floor where they are less. A high floor keeps levels that mean something by themselves.
        channels: of the stem's maps, each half as wide as the one before.
        width: of the tokens of the coarsest map.
        kept: numbers of each token from which the curve is predicted.
        hidden: units of the layers that predict it.
        steps: of the course, from where the wire comes in.
        longest: wire whose tip they reach, in sides of the picture.
        queries: points that are refined, at fixed shares of the length.
        tip_channels: of the heat map of the tip, over the stem's first map.
        revision_cells: of each revision: distance of the places it looks at, px of the picture.
        revision_layers: of attention between the points.
        cells: of each refinement, px of the picture.
        reach: such places to each side, of revisions and refinements.
    """

    image_px: Pixels = 256
    overview_level: Annotated[int, Interval(ge=0, le=12)] = 1
    line_px: Pixels = 2
    floor: Positive = FLOOR
    channels: tuple[Units, ...] = (16, 24, 32, 64)
    blocks: tuple[LayersOrNone, ...] = (0, 0, 0, 0)
    width: Units = 96
    heads: Units = 4
    encoder_layers: Layers = 2
    decoder_layers: Layers = 1
    kept: Units = 24
    hidden: tuple[Units, Units] = (512, 256)
    steps: Units = 60
    longest: Annotated[float, Interval(gt=0, le=100)] = 2.5
    queries: Units = 48
    control_points: Units = 24
    tip_channels: Units = 16
    revision_cells: tuple[PixelDistance, ...] = (8.0, 4.0)
    revision_layers: LayersOrNone = 1
    cells: tuple[PixelDistance, ...] = (2.0, 1.0, 0.5)
    reach: Layers = 4
    refinement_width: Units = 64


class OrderedPrediction(NamedTuple):
    """What the ordered network predicts from pictures."""

    course: Tensor  # (B, steps, 2) from where the wire comes in, beyond its tip, too; shares of the side
    length: Tensor  # (B,) of the wire, in steps
    overview: Tensor  # (B, queries, 2) points of the course up to the length, tip first
    tip: TipSeen
    revised: list[Tensor]  # (B, queries, 2) after each revision
    begun: list[Tensor]  # (B, queries, 2) points before each refinement
    stages: list[Tensor]  # and after it
    control: Tensor  # (B, control_points, 2)
    spread: Tensor  # (B, queries) logarithm of the expected distance of each point, hundredths of the side
    on_wire: Tensor  # (B, queries) logit that the point lies on the wire
    kind: ImageKind


class OrderedSplineFormer(CurveNetwork):
    """Picture to control points in one pass."""

    variant: ClassVar[str] = "ordered"
    positions: Tensor
    knots: Tensor
    shares: Tensor
    to_control: Tensor

    def __init__(self, settings: OrderedSettings) -> None:
        super().__init__()
        self.settings = s = settings
        divisor = 2 ** (s.overview_level + len(s.channels))
        if s.image_px % divisor or len(s.blocks) != len(s.channels):
            raise ValueError(f"expected blocks for each of the channels and image_px divisible by {divisor}, got {s}")
        side = s.image_px // divisor
        self.stem = Stem(CHANNELS, s.channels, s.blocks)
        self.to_tokens = nn.Linear(s.channels[-1], s.width)
        self.to_shade = nn.Linear(1, s.width)
        self.register_buffer("positions", grid_positions(side, s.width), persistent=False)
        self.encoder = nn.ModuleList(EncoderLayer(s.width, s.heads) for _ in range(s.encoder_layers))
        self.norm = nn.LayerNorm(s.width)
        self.narrow = nn.Linear(s.width, s.kept)
        self.whole = nn.Sequential(
            nn.Linear(s.kept * side**2, s.hidden[0]), nn.LayerNorm(s.hidden[0]), nn.SiLU(),
            nn.Linear(s.hidden[0], s.hidden[1]), nn.SiLU(),
        )  # fmt: skip
        self.to_points = nn.Linear(s.hidden[1], 2 * s.steps)
        self.to_length = nn.Linear(s.hidden[1], 1)
        self.queries = nn.Parameter(torch.randn(s.steps, s.width) * 0.5)
        self.decoder = nn.ModuleList(DecoderLayer(s.width, s.heads) for _ in range(s.decoder_layers))
        self.own_norm, self.own = nn.LayerNorm(s.width), nn.Linear(s.width, 2)
        self.tip = TipMap(s.channels[0], s.width, side * 2 ** (len(s.channels) - 1), s.tip_channels)
        self.levels = [max(int(math.log2(max(cell, 1.0))), 0) for cell in s.cells]
        self.revise = nn.ModuleList(
            Revision(s.channels[0], s.width, s.heads, s.revision_layers, s.queries, cell / s.image_px, s.reach)
            for cell in s.revision_cells
        )
        self.refine = nn.ModuleList(
            Refinement(CHANNELS, cell / s.image_px, s.reach, s.refinement_width) for cell in s.cells
        )
        self.to_quality = nn.Linear(s.refinement_width, 2)
        self.kind = ImageHead(s.width)
        self.step = s.longest / (s.steps - 1)  # share of the side
        knots = uniform_knots(s.control_points, _DENSER_AT_TIP, torch.float64)
        shares = torch.linspace(0, 1, s.queries, dtype=torch.float64)
        shares = shares * (_DENSER_AT_TIP + (1 - _DENSER_AT_TIP) * shares)
        at_queries = collocation(knots, shares)
        self.register_buffer("knots", knots.float(), persistent=False)
        self.register_buffer("shares", shares.float(), persistent=False)  # of the length, where each point lies
        self.register_buffer("to_control", torch.linalg.pinv(at_queries).float(), persistent=False)
        with torch.no_grad():
            for layer in (self.to_points, self.own):
                layer.weight.mul_(0.1)
            self.start_at(torch.full((s.steps, 2), 0.5), 0.5 * s.steps)

    @property
    def limit(self) -> int:
        return int(self.settings.control_points)

    @torch.no_grad()
    def start_at(self, course: Tensor, length: float) -> None:
        """Sets biases so that an untrained network predicts about this (steps, 2) course and length."""
        self.to_points.bias.copy_(course.flatten())
        self.to_length.bias.fill_(length / _STEPS)
        self.own.bias.zero_()

    def normalised(self, image: Tensor) -> list[Tensor]:
        """(B, 1, h, w) grey levels of 0 to 255 to contrast and dark lines, in full, by halves, by quarters, ..."""
        levels = max(self.settings.overview_level, *self.levels) + 1
        return line_pyramid(image, self.settings.line_px, levels, self.settings.floor)

    def _encoded(self, image: Tensor, pyramid: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        maps = self.stem(pyramid[self.settings.overview_level])
        # lines look alike whether the grey levels are inverted or not: shades do not
        shade = nn.functional.avg_pool2d(image / 127.5 - 1.0, image.shape[-1] // maps[-1].shape[-1])
        x = self.to_tokens(maps[-1].flatten(2).transpose(1, 2)) + self.to_shade(shade.flatten(2).transpose(1, 2))
        x = x + self.positions
        with bfloat16_in_training(self):
            for layer in self.encoder:
                x = layer(x)
        return self.norm(x), maps

    def _course(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """The (B, steps, 2) course and the (B,) length."""
        x = self.queries.expand(len(features), -1, -1)
        with bfloat16_in_training(self):
            for layer in decoder_layers(self.decoder):
                x = layer(x, layer.cross_attention.keys_values(features), causal=False)
            whole = self.whole(self.narrow(features).flatten(1)).float()
        course = self.to_points(whole).unflatten(1, (-1, 2)) + self.own(self.own_norm(x))
        length = (_STEPS * self.to_length(whole)[:, 0]).clamp(1.0, self.settings.steps - 1.0)
        return course, length

    def _up_to_length(self, course: Tensor, length: Tensor) -> Tensor:
        """(B, queries, 2) points of the course, tip first."""
        place = length[:, None] * (1.0 - self.shares)
        low = place.detach().floor().long().clamp(max=self.settings.steps - 2)
        part = (place - low)[..., None]

        def at(index: Tensor) -> Tensor:
            return course.gather(1, index[..., None].expand(-1, -1, 2))

        return at(low) * (1 - part) + at(low + 1) * part

    def refinements(self) -> list[Refinement]:
        """The refinements, under their own type."""
        return [cast(Refinement, step) for step in self.refine]

    def refined(self, pyramid: list[Tensor], points: Tensor) -> tuple[list[Tensor], list[Tensor], Tensor]:
        """The points before and after each refinement, and what the last one saw."""
        begun, stages = [], []
        hidden = points
        for step, level in zip(self.refinements(), self.levels, strict=True):
            points = at_equal_shares(points.detach(), self.shares)
            begun.append(points)
            points, hidden = step(pyramid[level], points)
            stages.append(points)
        return begun, stages, hidden

    def _predicted(
        self, image: Tensor, starts: Tensor | None, begins: Tensor | None
    ) -> tuple[OrderedPrediction, Tensor]:
        pyramid = self.normalised(image)
        features, maps = self._encoded(image, pyramid)
        course, length = self._course(features)
        overview = self._up_to_length(course, length)
        points, near = overview.detach(), len(image)
        if starts is not None and begins is not None:
            near = len(starts)
            points = torch.where(begins[:, None, None], starts, points[:near])
        fine = maps[0][:near]
        coarse = features[:near].transpose(1, 2).unflatten(2, maps[-1].shape[2:])
        revised = []
        tip = None
        for number, step in enumerate(self.revise):
            points = step(fine, coarse, points.detach())
            revised.append(points)
            if number == 0:
                tip = self.tip(fine, coarse, points[:, 0].detach())
                points = led_to(points, tip.place)
        assert tip is not None
        begun, stages, hidden = self.refined([level[:near] for level in pyramid], points)
        spread, on_wire = self.to_quality(hidden).unbind(-1)
        control = self.to_control @ at_equal_shares(stages[-1], self.shares)
        kind = self.kind(features)
        prediction = OrderedPrediction(
            course, length, overview, tip, revised, begun, stages, control, spread, on_wire, kind
        )
        return prediction, features

    def forward(self, image: Tensor, starts: Tensor | None = None, begins: Tensor | None = None) -> OrderedPrediction:
        """Reads pictures.

        Args:
            image: (B, 1, image_px, image_px) grey levels of 0 to 255.
            starts: (n, queries, 2) curves that revisions, tip and refinements may begin with instead of the overview's;
                pictures beyond the first n get no more than an overview.
            begins: (n,) where they do.
        """
        return self._predicted(image, starts, begins)[0]

    @torch.no_grad()
    def read(self, image: Tensor) -> CurveBatch:
        return self._as_batch(*self._predicted(image, None, None))

    @torch.no_grad()
    def read_again(self, image: Tensor, curves: Tensor) -> CurveBatch:
        begins = torch.ones(len(image), dtype=torch.bool, device=image.device)
        return self._as_batch(*self._predicted(image, at_equal_shares(curves, self.shares), begins))

    def _as_batch(self, prediction: OrderedPrediction, features: Tensor) -> CurveBatch:
        control = prediction.control
        knots = self.knots[FEWEST_TOKENS:].expand(len(control), -1)[..., None]
        lengths = torch.full((len(control),), self.limit, device=control.device)
        on_wire = torch.sigmoid(prediction.on_wire).mean(1)
        error = prediction.spread.exp().mean(1) / 100
        return CurveBatch(torch.cat([knots, control], -1), lengths, features, prediction.kind, on_wire, error)

    @torch.no_grad()
    def attention(self, image: Tensor) -> tuple[Tensor, Tensor]:
        features, _ = self._encoded(image, self.normalised(image))
        x = self.queries.expand(len(image), -1, -1)
        for layer in decoder_layers(self.decoder)[:-1]:
            x = layer(x, layer.cross_attention.keys_values(features), causal=False)
        last = decoder_layers(self.decoder)[-1]
        normed = last.norm_self(x)
        x = x + last.self_attention(normed, last.self_attention.keys_values(normed))
        weights = last.cross_attention.weights(last.norm_cross(x), last.cross_attention.keys_values(features))
        return weights, torch.full((len(image),), weights.shape[2])

    def fit_tokens(self, points_px: Array) -> Array:
        return tokens_on_knots(points_px, self.knots.double().cpu().numpy())
