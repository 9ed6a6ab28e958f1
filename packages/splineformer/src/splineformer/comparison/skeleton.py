"""Traces the wire in a mask: its skeleton, the longest way through it, gaps joined, the tip found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from guide3d.geometry.polyline import Array, arc_length
from guide3d.opencv import cv2

_SMALLEST = 12  # pixels: smaller pieces of the skeleton are specks, and dropped
_WIDEST_GAP_PX = 60.0  # pieces whose ends are nearer than this to the wire traced so far are joined to it
_SMOOTHING_PX = 3.0  # standard deviation, along the way, of the filter that takes the steps of pixels off
_HALF = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5))  # half of the neighbours, each pair counted once


@dataclass(frozen=True, eq=False)
class TracedMask:
    """A curve traced from a mask.

    Attributes:
        points_px: (n, 2) tip first; None where the mask shows nothing.
        pieces: connected parts of the mask, specks left out.
    """

    points_px: Array | None
    pieces: int

    @property
    def discontinuities(self) -> int:
        """Gaps in the mask."""
        return max(self.pieces - 1, 0)


def trace_mask(mask: ArrayLike, end_px: ArrayLike) -> TracedMask:
    """Traces the wire in a mask.

    Each piece of the skeleton gives its longest shortest way, so a loop is cut short where the wire crosses itself. The
    longest piece comes first; others are joined to its ends, the nearest first.

    Args:
        mask: (h, w), not 0 on the wire.
        end_px: (2,) where wires of this camera usually enter the image: the traced end nearer to it is not the tip.

    Raises:
        ValueError: a mask of another shape.
    """
    from skimage.morphology import skeletonize

    wire = np.asarray(mask) != 0
    if wire.ndim != 2:
        raise ValueError(f"mask: expected (h, w), got {wire.shape}")
    rows, columns = np.nonzero(wire.any(axis=1))[0], np.nonzero(wire.any(axis=0))[0]
    if not len(rows):
        return TracedMask(None, 0)
    # only the part of the image where there is anything: thinning is slow
    top, left = rows[0], columns[0]
    line = skeletonize(np.pad(wire[top : rows[-1] + 1, left : columns[-1] + 1], 1))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(line.astype(np.uint8), connectivity=8)
    components = [label for label in range(1, count) if boxes[label, cv2.CC_STAT_AREA] >= _SMALLEST]
    if not components:
        return TracedMask(None, 0)
    corner = np.array([left - 1, top - 1])
    ways = []
    for label in components:
        x, y, width, height = boxes[label, :4]
        ways.append(_longest_way(labels[y : y + height, x : x + width] == label) + corner + (x, y))
    points = _joined(ways)
    ends = np.linalg.norm(points[[0, -1]] - np.asarray(end_px, float), axis=1)
    points = points[::-1] if ends[0] < ends[1] else points
    return TracedMask(ndimage.gaussian_filter1d(points, _SMOOTHING_PX, axis=0, mode="nearest"), len(components))


def _longest_way(line: NDArray[np.bool_]) -> Array:
    """(n, 2) x, y of the longest shortest way through the pixels of a connected skeleton."""
    places = np.argwhere(line)
    number = np.full(line.shape, -1)
    number[tuple(places.T)] = np.arange(len(places))
    starts, ends, lengths = [], [], []
    for down, right, length in _HALF:
        rows, columns = places[:, 0] + down, places[:, 1] + right
        inside = (rows < line.shape[0]) & (columns >= 0) & (columns < line.shape[1])
        to = np.full(len(places), -1)
        to[inside] = number[rows[inside], columns[inside]]
        sources = np.flatnonzero(to >= 0)
        starts.append(sources)
        ends.append(to[sources])
        lengths.append(np.full(len(sources), length))
    graph = sparse.coo_matrix(
        (np.concatenate(lengths), (np.concatenate(starts), np.concatenate(ends))), (len(places),) * 2
    ).tocsr()
    first = int(np.argmax(csgraph.dijkstra(graph, directed=False, indices=0)))
    distance, before = csgraph.dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    way = [int(np.argmax(distance))]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return places[way][:, ::-1].astype(float)


def _joined(ways: list[Array]) -> Array:
    """The longest way and those whose ends are near, one behind the other: always the nearest end first."""
    ways = sorted(ways, key=lambda way: -arc_length(way)[-1])
    whole, others = ways[0], ways[1:]
    ends = np.array([way[[-1, 0]] for way in others]).reshape(-1, 1, 2, 2)  # of each, last and first
    left = np.ones(len(others), bool)
    while left.any():
        gaps = np.linalg.norm(whole[[-1, 0]][:, None] - ends, axis=3)  # way, end of the whole, end of the way
        gaps[~left] = np.inf
        place, end, start = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
        if gaps[place, end, start] > _WIDEST_GAP_PX:
            break
        left[place] = False
        other = others[place] if start == 1 else others[place][::-1]
        whole = np.vstack([whole, other]) if end == 0 else np.vstack([other[::-1], whole])
    return whole
