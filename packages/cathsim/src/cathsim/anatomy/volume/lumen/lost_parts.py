"""Parts of a vessel that its smoothed wall has parted from the rest, though its labels are in one piece."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.volume.voxel_graph import neighbours

_LEAST_SHARE = 0.03  # of a vessel's voxels, from which on a part counts as lost
_LEAST_DEPTH = 0.6  # of the vessel's usual depth, likewise: a bar between two vessels is thinner
_USUAL = 0.98  # quantile of the depths of a vessel's voxels
_AROUND = 8e-3  # m about a lost part in which its way to the rest is looked for

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def ways_to_lost(mask: Mask, kept: Mask, spacing: Array) -> list[Array]:
    """Ways along a vessel's middle from what is kept of it to the far end of each part that is lost.

    Args:
        mask: (nx, ny, nz) the vessel's voxels in a box.
        kept: (nx, ny, nz) those of them that lie in the lumen.
        spacing: (3,) m between voxels.

    Returns:
        For each part that is lost and hangs together with the rest by its voxels: (n, 3) m, middles of voxels in the
        axes of the box.
    """
    from scipy.ndimage import distance_transform_edt, label

    parts, count = label(mask & ~kept, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    large = [n for n in range(1, count + 1) if sizes[n] >= _LEAST_SHARE * np.count_nonzero(mask)]
    if not large:
        return []
    depth = distance_transform_edt(np.pad(mask, 1), spacing)[1:-1, 1:-1, 1:-1]
    usual = float(np.quantile(depth[mask], _USUAL))
    ways = []
    for number in large:
        places = np.argwhere(parts == number)
        if float(depth[tuple(places.T)].max()) < _LEAST_DEPTH * usual:
            continue
        around = np.ceil(_AROUND / spacing).astype(int)
        low = np.maximum(places.min(axis=0) - around, 0)
        high = places.max(axis=0) + around + 1
        window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        way = _way(depth[window], kept[window], parts[window] == number, spacing)
        if way is not None:
            ways.append((way + low) * spacing)
    return ways


def _way(depth: Array, kept: Mask, lost: Mask, spacing: Array) -> NDArray[np.int64] | None:
    """Voxels (n, 3) from what is kept to the farthest of a lost part; None where no way leads there."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    voxels = np.argwhere(depth > 0)
    dear = (float(spacing.min()) / depth[tuple(voxels.T)]) ** 2
    pairs, lengths = neighbours(voxels, spacing)
    first, second = pairs.T
    graph = csr_matrix((lengths * (dear[first] + dear[second]), (first, second)), shape=(len(voxels),) * 2)
    ours, theirs = kept[tuple(voxels.T)], np.flatnonzero(lost[tuple(voxels.T)])
    if not ours.any():
        return None
    away, before, _ = dijkstra(
        graph, directed=False, indices=np.flatnonzero(ours), return_predecessors=True, min_only=True
    )
    reached = theirs[np.isfinite(away[theirs])]
    if len(reached) == 0:
        return None
    way = [int(reached[np.argmax(away[reached])])]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    found: NDArray[np.int64] = voxels[way[::-1]]
    return found
