"""Revision: the whole curve looks at itself and at the picture round its points, and each point goes to its own place.

Where a wire crosses itself or runs beside itself, what lies nearest may be another strand. So the points attend to each
other: a curve that knows its whole course tells its strands apart.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from splineformer.modeling.transformer import EncoderLayer

_UNIT = 0.05  # of the side: unit of the moves


class Revision(nn.Module):
    """One step of moving the points of a curve towards their own places along the wire.

    Args:
        channels: of the fine map.
        width: of the memory and of the points' tokens.
        heads: of attention.
        layers: how many.
        queries: points.
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
            coarse: (B, width, h, w) memory.
            points: (B, queries, 2) x, y as shares of the image's side, tip first.

        Returns:
            (B, queries, 2).
        """
        seen = points[:, :, None] + self.cell * self.grid
        near = F.grid_sample(fine, 2 * seen - 1, align_corners=False, padding_mode="border")
        far = F.grid_sample(coarse, 2 * points[:, :, None] - 1, align_corners=False, padding_mode="border")
        step = (points[:, 1:] - points[:, :-1]) * points.shape[1]
        step = torch.cat([step, step[:, -1:]], 1)
        x = self.near(near.permute(0, 2, 3, 1).flatten(2)) + self.far(far[..., 0].transpose(1, 2))
        x = x + self.place(torch.cat([4 * points - 2, step], -1)) + self.own
        for layer in self.layers:
            x = layer(x)
        return points + _UNIT * self.out(self.norm(x))
