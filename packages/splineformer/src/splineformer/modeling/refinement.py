"""Refinement: what is seen round each predicted point, in the curve's own frame, tells how far the point is off."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

_FLAGS = 2  # the tip, the end
_GAPS = (1, 2, 4)  # between the neighbours that agree, points


class Refinement(nn.Module):
    """One step of moving the points of a curve onto the wire.

    At each point the picture's maps are sampled on a grid along the tangent and the normal, so that what is learnt
    holds for every direction; convolutions along the curve let neighbours agree.

    Args:
        channels: of the map.
        cell: distance of the grid's places, as a share of the image's side.
        reach: places to each side of the point.
        width: of the hidden layers.
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
        hidden = F.relu(self.read(seen)).transpose(1, 2)
        for layer in self.along:
            hidden = hidden + F.relu(layer(hidden))
        hidden = hidden.transpose(1, 2)
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
    wanted = shares[None] * along[:, -1:]
    # counting instead of a search: exports know it
    after = (along[:, None] < wanted[..., None]).sum(-1).clamp(1, along.shape[1] - 1)
    low, high = along.gather(1, after - 1), along.gather(1, after)
    part = ((wanted - low) / (high - low).clamp_min(1e-9)).clamp(0.0, 1.0)[..., None]

    def at(index: Tensor) -> Tensor:
        return points.gather(1, index[..., None].expand(-1, -1, 2))

    return at(after - 1) * (1 - part) + at(after) * part
