"""The points of a device in the chain in which two devices lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def points_behind(points: Array, links: Sequence[float], behind: float) -> Array:
    """The part of a chain that begins at a distance behind its tip.

    Args:
        points: ends of the chain's links from its tip on, m. Shape (n + 1, 3).
        links: lengths of the n links from the proximal end, m.
        behind: where the part begins, m along the chain from its tip.

    Returns:
        The part's beginning, then the ends of the links behind it, m. Shape (k, 3).
    """
    arcs = np.concatenate(([0.0], np.cumsum(links[::-1])))
    first = int(np.searchsorted(arcs, behind, side="right"))
    share = (behind - arcs[first - 1]) / (arcs[first] - arcs[first - 1]) if first < len(arcs) else 0.0
    start = points[first - 1] + share * (points[min(first, len(points) - 1)] - points[first - 1])
    return np.concatenate((start[None], points[first:]))


def wire_and_catheter(points: Array, links: Sequence[float], lead: float) -> tuple[Array, Array]:
    """Both devices, each from its tip on, m. Shapes (k, 3) and (m, 3).

    Args:
        points, links: as of `points_behind`.
        lead: how far the wire's tip is ahead of the catheter's, m; negative: drawn back into it.
    """
    return points_behind(points, links, max(-lead, 0.0)), points_behind(points, links, max(lead, 0.0))
