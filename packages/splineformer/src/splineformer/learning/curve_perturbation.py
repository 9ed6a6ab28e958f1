"""Drift: curves that went astray smoothly, as predicted ones do, for refinements to learn from."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

_LEAST, _MOST = 0.004, 0.07  # of the image's side, standard deviation of the drift
_NODES = (3, 10)  # random offsets along a curve, at least and at most


def drifted(points: Tensor, generator: np.random.Generator) -> Tensor:
    """Moves curves by offsets that change smoothly along them, of a size that differs from curve to curve.

    Args:
        points: (B, n, 2) shares of the image's side.
        generator: of the draws.

    Returns:
        (B, n, 2).
    """
    batch, count = points.shape[:2]
    size = np.exp(generator.uniform(np.log(_LEAST), np.log(_MOST), (batch, 1, 1)))
    nodes = int(generator.integers(_NODES[0], _NODES[1] + 1))
    offsets = torch.from_numpy((size * generator.standard_normal((batch, 2, nodes))).astype(np.float32))
    return points + F.interpolate(offsets, count, mode="linear", align_corners=True).transpose(1, 2)
