"""Parts that hang together: of numbered things and the pairs of them that are linked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def linked_parts(first: NDArray[np.integer], second: NDArray[np.integer], count: int) -> NDArray[np.int32]:
    """Number (count,) of the part that each of so many things belongs to, from 0 on.

    Args:
        first, second: numbers (m,) of the things that are linked to each other.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int32)
