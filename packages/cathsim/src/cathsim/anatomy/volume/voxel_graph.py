"""Neighbouring voxels of a part of a volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def neighbours(
    voxels: NDArray[np.int64], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of voxels that share a face, an edge or a corner, and the distances (m,) between them, m.

    Args:
        voxels: (n, 3) indices, none of them negative.
        spacing: (3,) m between voxels.
    """
    number = np.full(voxels.max(axis=0) + 3, -1, dtype=np.int64)
    number[tuple((voxels + 1).T)] = np.arange(len(voxels))
    pairs, lengths = [], []
    for step in [s for s in np.ndindex(3, 3, 3) if s > (1, 1, 1)]:  # the other half are the same pairs
        other = number[tuple((voxels + np.array(step)).T)]
        near = np.flatnonzero(other >= 0)
        pairs.append(np.stack([near, other[near]], axis=1))
        lengths.append(np.full(len(near), np.linalg.norm((np.array(step) - 1) * spacing)))
    return np.concatenate(pairs), np.concatenate(lengths)
