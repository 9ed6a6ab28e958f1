"""Refinement: the features round each predicted point, in the curve's own frame, tell how far the point is off."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class Refinement(nn.Module):
    """One step of moving the points of a curve onto the wire.

    At each point the feature map is sampled on a grid along the tangent and the normal, so that what is learnt holds
    for every direction; convolutions along the curve let neighbours agree.

    Args:
        channels: of the feature map.
        cell: side of a cell of the feature map, as a share of the image's side.
        reach: cells to each side of the point.
        width: of the hidden layers.
        further: of what else is known of each point.
    """

    grid: Tensor

    def __init__(self, channels: int, cell: float, reach: int, width: int, further: int = 0) -> None:
        super().__init__()
        self.cell = cell
        line = torch.arange(-reach, reach + 1, dtype=torch.float32)
        along, across = torch.meshgrid(line, line, indexing="ij")
        self.register_buffer("grid", torch.stack([along, across], -1).flatten(0, 1), persistent=False)
        # 2 for the turn of the curve at the point: a bend looks unlike a straight wire
        self.read = nn.Linear(channels * len(self.grid) + further + 2, width)
        self.along = nn.ModuleList(nn.Conv1d(width, width, 5, padding=2) for _ in range(3))
        self.out = nn.Linear(width, 2)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, features: Tensor, points: Tensor, further: Tensor | None = None) -> Tensor:
        """Moves points.

        Args:
            features: (B, C, h, w).
            points: (B, n, 2) x, y as shares of the image's side, tip first.
            further: (B, n, k).

        Returns:
            (B, n, 2) points nearer to the wire.
        """
        padded = torch.cat([2 * points[:, :1] - points[:, 1:2], points, 2 * points[:, -1:] - points[:, -2:-1]], 1)
        tangent = F.normalize(padded[:, 2:] - padded[:, :-2], dim=-1, eps=1e-6)
        normal = torch.stack([-tangent[..., 1], tangent[..., 0]], -1)
        frame = torch.stack([tangent, normal], -2)  # (B, n, 2 axes, 2)
        places = points[:, :, None] + self.cell * (self.grid @ frame)  # (B, n, G, 2)
        read = F.grid_sample(features, 2 * places - 1, align_corners=False, padding_mode="border")
        turn = (frame @ (padded[:, 2:] + padded[:, :-2] - 2 * points)[..., None])[..., 0] / self.cell
        parts = [read.permute(0, 2, 3, 1).flatten(2), turn.clamp(-8, 8)]
        if further is not None:
            parts.append(further)
        hidden = F.relu(self.read(torch.cat(parts, -1))).transpose(1, 2)
        for layer in self.along:
            hidden = hidden + F.relu(layer(hidden))
        offset = self.out(hidden.transpose(1, 2)) * self.cell
        return points + (offset[..., None, :] @ frame)[..., 0, :]
