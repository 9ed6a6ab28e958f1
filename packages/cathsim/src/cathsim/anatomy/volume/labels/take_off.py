"""Which of a label's contacts is its take-off: the one at its end; others lie along its side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.volume.voxel_graph import neighbours

_MOST_VOXELS = 20_000  # of a label; larger ones are thinned out

Array = NDArray[np.float64]


def from_far_end(
    label: NDArray[np.bool_], contacts: Mapping[int, Array], spacing: Array
) -> tuple[dict[int, float], float]:
    """How far (m) each contact of a label lies along it, from the end that is farthest from all of them.

    Args:
        label: (nx, ny, nz) voxels of a vessel.
        contacts: by the vessel that is touched, (n, 3) m, in the lattice's axes.
        spacing: (3,) m between voxels.

    Returns:
        By the same vessels, 0 where no way within the label leads there; and the radius, m, of a tube of the label's
        length and volume.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    voxels = np.argwhere(label)
    corner = voxels.min(axis=0)
    step = max(int(np.ceil((len(voxels) / _MOST_VOXELS) ** (1 / 3))), 1)
    places = np.unique((voxels - corner) // step, axis=0)
    pairs, lengths = neighbours(places, step * spacing)
    graph = csr_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(places),) * 2)
    tree = cKDTree((corner + places * step + (step - 1) / 2) * spacing)
    nodes = {other: tree.query(touched)[1] for other, touched in contacts.items()}
    near = np.unique(np.concatenate(list(nodes.values())))
    away = dijkstra(graph, directed=False, indices=near, min_only=True)
    far_end = int(np.argmax(np.where(np.isfinite(away), away, -1.0)))
    along = dijkstra(graph, directed=False, indices=far_end)
    along[~np.isfinite(along)] = 0.0
    length = max(float(along.max()), float(np.min(spacing)))
    radius = float(np.sqrt(len(voxels) * np.prod(spacing) / (np.pi * length)))
    return {other: float(np.median(along[some])) for other, some in nodes.items()}, radius
