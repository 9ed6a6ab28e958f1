"""The walker: from where the wire comes in, step by step along it to its tip, each step from what is seen nearby.

A step sees the feature map round the last point, turned into the direction of the last step. It tells the way to the
next point, and whether that is the tip. What is learnt holds anywhere and in any direction, so wires that run as none
did in training, and loops, are followed all the same: at a crossing the direction decides.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

STOP = 0.5


class Steps(NamedTuple):
    """What the walker says at places."""

    offsets: Tensor  # (B, K, 2) along and across the direction, in cells
    end: Tensor  # (B, K) logit that the tip lies within this step


class Walk(NamedTuple):
    """Ways that were walked."""

    points: Tensor  # (B, most + 1, 2) shares of the side, from the start on; after the tip it repeats
    lengths: Tensor  # (B,) points of each: up to the tip, or to where it seemed likeliest
    arrived: Tensor  # (B,) whether the tip was seen


class Walker(nn.Module):
    """Steps along a wire.

    Args:
        channels: of the feature map.
        cell: side of a cell of the feature map, as a share of the image's side.
        reach: cells seen to each side.
        width: of the hidden layers.
        most: steps of the longest wire.
    """

    grid: Tensor

    def __init__(self, channels: int, cell: float, reach: int, width: int, most: int) -> None:
        super().__init__()
        self.cell, self.most = cell, most
        line = torch.arange(-reach, reach + 1, dtype=torch.float32)
        along, across = torch.meshgrid(line, line, indexing="ij")
        # a little ahead of the point: what lies behind is known
        self.register_buffer("grid", torch.stack([along + 1, across], -1).flatten(0, 1), persistent=False)
        self.read = nn.Sequential(
            nn.Linear(channels * len(self.grid), width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.offset, self.end = nn.Linear(width, 2), nn.Linear(width, 1)

    def forward(self, features: Tensor, places: Tensor, directions: Tensor) -> Steps:
        """What to do at places.

        Args:
            features: (B, C, h, w).
            places: (B, K, 2) shares of the side.
            directions: (B, K, 2) unit vectors of the last step.
        """
        seen = self.cell * (self.grid @ frames(directions))
        read = F.grid_sample(features, 2 * (places[:, :, None] + seen) - 1, align_corners=False, padding_mode="zeros")
        hidden = self.read(read.permute(0, 2, 3, 1).flatten(2))
        return Steps(self.offset(hidden), self.end(hidden)[..., 0])

    @torch.no_grad()
    def walk(self, features: Tensor, start: Tensor, direction: Tensor) -> Walk:
        """Walks from (B, 2) starts in (B, 2) directions until the tip, or the last step."""
        place, direction = start[:, None], direction[:, None]
        points, arrived = [place], torch.zeros(len(start), dtype=torch.bool, device=start.device)
        lengths = torch.ones(len(start), dtype=torch.long, device=start.device)
        likeliest, likely_length = torch.full_like(start[:, 0], -torch.inf), lengths
        for _ in range(self.most):
            steps = self(features, place, direction)
            way = self.cell * (steps.offsets[..., None, :] @ frames(direction))[..., 0, :]
            going = ~arrived
            place = torch.where(going[:, None, None], (place + way).clamp(0.0, 1.0), place)
            lengths = lengths + going
            direction = F.normalize(direction + F.normalize(way, dim=-1, eps=1e-9), dim=-1, eps=1e-9)
            points.append(place)
            better = going & (steps.end[:, 0] > likeliest)
            likeliest = torch.where(better, steps.end[:, 0], likeliest)
            likely_length = torch.where(better, lengths, likely_length)
            arrived = arrived | (torch.sigmoid(steps.end[:, 0]) > STOP)
            if bool(arrived.all()):
                break
        every = torch.cat(points, 1)
        every = torch.cat([every, every[:, -1:].expand(-1, self.most + 1 - every.shape[1], -1)], 1)
        return Walk(every, torch.where(arrived, lengths, likely_length), arrived)


def frames(directions: Tensor) -> Tensor:
    """(..., 2, 2) axes along and across (..., 2) directions."""
    return torch.stack([directions, torch.stack([-directions[..., 1], directions[..., 0]], -1)], -2)


def at_shares_of_length(points: Tensor, lengths: Tensor, shares: Tensor) -> Tensor:
    """(B, n, 2) points at shares of the length of polylines.

    Args:
        points: (B, m, 2); what lies beyond the lengths repeats the last point.
        lengths: (B,) points of each.
        shares: (n,) in 0 to 1, in any order.
    """
    step = (points[:, 1:] - points[:, :-1]).norm(dim=-1)
    counted = torch.arange(step.shape[1], device=step.device)[None] < (lengths - 1)[:, None]
    step = torch.where(counted, step, 0.0)
    along = torch.cat([torch.zeros_like(step[:, :1]), step.cumsum(1)], 1)
    wanted = shares[None] * along[:, -1:]
    after = torch.searchsorted(along.contiguous(), wanted.contiguous()).clamp(1, along.shape[1] - 1)
    low, high = along.gather(1, after - 1), along.gather(1, after)
    part = ((wanted - low) / (high - low).clamp_min(1e-9)).clamp(0.0, 1.0)[..., None]

    def at(index: Tensor) -> Tensor:
        return points.gather(1, index[..., None].expand(-1, -1, 2))

    return at(after - 1) * (1 - part) + at(after) * part
