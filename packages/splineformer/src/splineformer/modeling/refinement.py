"""Parts of the ordered variant that find points: the tip's heat map, and steps that move the points of a curve."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from guide3d.learning.precision import bfloat16_in_training
from splineformer.modeling.convolutions import convolution
from splineformer.modeling.transformer import EncoderLayer

_UNIT = 0.05  # of the side: unit of a revision's moves
_FLAGS = 2  # the tip, the end
_GAPS = (1, 2, 4)  # between the neighbours that agree, points


_SPREAD = 0.06  # of the side: that of the bell before training


class Revision(nn.Module):
    """One step of moving the points of a curve towards their own places along the wire.

    Args:
        width: of the features and of the points' tokens.
        cell: distance of the places looked at, as a share of the image's side.
        reach: such places to each side of a point.
    """

    grid: Tensor

    def __init__(
        self, channels: int, width: int, heads: int, layers: int, queries: int, cell: float, reach: int
    ) -> None:
        super().__init__()
        self.cell = cell
        line = torch.arange(-reach, reach + 1, dtype=torch.float32)
        rows, columns = torch.meshgrid(line, line, indexing="ij")
        self.register_buffer("grid", torch.stack([columns, rows], -1).flatten(0, 1), persistent=False)
        self.near = nn.Linear(channels * len(self.grid), width)
        self.far = nn.Linear(width, width)
        self.place = nn.Linear(4, width)
        self.own = nn.Parameter(torch.randn(queries, width) * 0.5)
        self.layers = nn.ModuleList(EncoderLayer(width, heads) for _ in range(layers))
        self.norm, self.out = nn.LayerNorm(width), nn.Linear(width, 2)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, fine: Tensor, coarse: Tensor, points: Tensor) -> Tensor:
        """Moves points.

        Args:
            fine: (B, channels, h, w).
            coarse: (B, width, h, w) features of the encoder.
            points: (B, queries, 2) x, y as shares of the image's side, tip first.

        Returns:
            (B, queries, 2).
        """
        seen = points[:, :, None] + self.cell * self.grid
        near = F.grid_sample(fine, 2 * seen - 1, align_corners=False, padding_mode="border")
        far = F.grid_sample(coarse, 2 * points[:, :, None] - 1, align_corners=False, padding_mode="border")
        step = (points[:, 1:] - points[:, :-1]) * points.shape[1]
        step = torch.cat([step, step[:, -1:]], 1)
        with bfloat16_in_training(self):
            x = self.near(near.permute(0, 2, 3, 1).flatten(2)) + self.far(far[..., 0].transpose(1, 2))
        x = x + self.place(torch.cat([4 * points - 2, step], -1)) + self.own
        with bfloat16_in_training(self):
            for layer in self.layers:
                x = layer(x)
        return points + _UNIT * self.out(self.norm(x))


class Refinement(nn.Module):
    """One step of moving the points of a curve onto the wire.

    At each point the picture's maps are sampled on a grid along the tangent and the normal, so that what is learnt
    holds for every direction; convolutions along the curve let neighbours agree.

    Args:
        cell: distance of the grid's places, as a share of the image's side.
        reach: places to each side of the point.
    """

    grid: Tensor

    def __init__(self, channels: int, cell: float, reach: int, width: int) -> None:
        super().__init__()
        self.cell, self.sight = cell, (reach + 1) * cell
        line = torch.arange(-reach, reach + 1, dtype=torch.float32)
        along, across = torch.meshgrid(line, line, indexing="ij")
        self.register_buffer("grid", torch.stack([along, across], -1).flatten(0, 1), persistent=False)
        # 2 for the turn of the curve at the point: a bend looks unlike a straight wire
        self.read = nn.Linear(channels * len(self.grid) + _FLAGS + 2, width)
        self.along = nn.ModuleList(nn.Conv1d(width, width, 5, padding=2 * gap, dilation=gap) for gap in _GAPS)
        self.out = nn.Linear(width, 2)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, features: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        """Moves points.

        Args:
            features: (B, C, h, w).
            points: (B, n, 2) x, y as shares of the image's side, tip first.

        Returns:
            (B, n, 2) points nearer to the wire, and (B, n, width) what was seen there.
        """
        padded = torch.cat([2 * points[:, :1] - points[:, 1:2], points, 2 * points[:, -1:] - points[:, -2:-1]], 1)
        tangent = F.normalize(padded[:, 2:] - padded[:, :-2], dim=-1, eps=1e-6)
        normal = torch.stack([-tangent[..., 1], tangent[..., 0]], -1)
        frame = torch.stack([tangent, normal], -2)  # (B, n, 2 axes, 2)
        places = points[:, :, None] + self.cell * (self.grid @ frame)  # (B, n, G, 2)
        read = F.grid_sample(features, 2 * places - 1, align_corners=False, padding_mode="border")
        turn = (frame @ (padded[:, 2:] + padded[:, :-2] - 2 * points)[..., None])[..., 0] / self.cell
        flags = torch.zeros_like(points)
        flags[:, 0, 0], flags[:, -1, 1] = 1.0, 1.0
        seen = torch.cat([read.permute(0, 2, 3, 1).flatten(2), turn.clamp(-8, 8), flags], -1)
        with bfloat16_in_training(self):
            hidden = F.relu(self.read(seen)).transpose(1, 2)
            for layer in self.along:
                hidden = hidden + F.relu(layer(hidden))
        hidden = hidden.transpose(1, 2).float()
        offset = self.out(hidden) * self.cell
        return points + (offset[..., None, :] @ frame)[..., 0, :], hidden


def at_equal_shares(points: Tensor, shares: Tensor) -> Tensor:
    """(B, n, 2) points at shares of the length of polylines.

    Args:
        points: (B, m, 2).
        shares: (n,) in 0 to 1, ascending.
    """
    step = (points[:, 1:] - points[:, :-1]).norm(dim=-1)
    along = torch.cat([torch.zeros_like(step[:, :1]), step.cumsum(1)], 1)
    lengths = shares[None] * along[:, -1:]
    # counting instead of a search: exports know it
    after = (along[:, None] < lengths[..., None]).sum(-1).clamp(1, along.shape[1] - 1)
    low, high = along.gather(1, after - 1), along.gather(1, after)
    part = ((lengths - low) / (high - low).clamp_min(1e-9)).clamp(0.0, 1.0)[..., None]

    def at(index: Tensor) -> Tensor:
        return points.gather(1, index[..., None].expand(-1, -1, 2))

    return at(after - 1) * (1 - part) + at(after) * part


class TipSeen(NamedTuple):
    """What the cells predict of the tip."""

    logits: Tensor  # (B, cells), row by row, the bell among them
    offsets: Tensor  # (B, cells, 2) from a cell's centre to the tip, in cells
    place: Tensor  # (B, 2) shares of the side


class TipMap(nn.Module):
    """A fine feature map of `channels` and side², and the encoder's features of `width`, to the place of the tip."""

    cells: Tensor

    def __init__(self, channels: int, width: int, side: int, hidden: int) -> None:
        super().__init__()
        self.side = side
        self.near, self.far = nn.Conv2d(channels, hidden, 1), nn.Conv2d(width, hidden, 1)
        self.mix = convolution(hidden, hidden)
        self.out = nn.Conv2d(hidden, 3, 1)
        self.spread = nn.Parameter(torch.tensor(math.log(_SPREAD)))
        centres = (torch.arange(side) + 0.5) / side
        rows, columns = torch.meshgrid(centres, centres, indexing="ij")
        self.register_buffer("cells", torch.stack([columns, rows], -1).flatten(0, 1), persistent=False)

    def forward(self, fine: Tensor, coarse: Tensor, expected: Tensor) -> TipSeen:
        """Finds the tip.

        Args:
            fine: (B, channels, side, side).
            coarse: (B, width, h, w) features.
            expected: (B, 2) where the curve has its tip, shares of the side.
        """
        known = F.interpolate(self.far(coarse), (self.side, self.side), mode="bilinear", align_corners=False)
        predicted = self.out(self.mix(F.relu(self.near(fine) + known))).flatten(2)
        away = (self.cells - expected[:, None]).square().sum(-1)
        logits = predicted[:, 0] - away * (0.5 * torch.exp(-2.0 * self.spread))
        offsets = predicted[:, 1:].transpose(1, 2)
        best = logits.argmax(-1)[:, None, None].expand(-1, 1, 2)
        place = self.cells[best[:, 0, 0]] + offsets.gather(1, best)[:, 0] / self.side
        return TipSeen(logits, offsets, place)


def led_to(points: Tensor, tip: Tensor) -> Tensor:
    """Leads (B, n, 2) points, tip first, to their (B, 2) tips: all of the way at the tip, less and less behind it."""
    share = torch.linspace(1.0, 0.0, points.shape[1], device=points.device).square()
    return points + share[:, None] * (tip - points[:, 0])[:, None]
