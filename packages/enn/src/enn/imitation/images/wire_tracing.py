"""The wire in a mask: its pixels in order from the tip on, what is no wire, and the image without it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]

SPECK = 5  # px: fewer that hang together are no wire


def trace_wire(mask: NDArray[np.bool_], entry: tuple[int, int] | None = None) -> NDArray[np.intp]:
    """The wire's pixels in order, from the tip to the access site.

    The longest of the shortest ways inside the mask that begin at the entry.

    Args:
        mask: the wire's pixels. Shape (height, width).
        entry: row and column of the end that does not move; None: the lowest pixel.

    Returns:
        Rows and columns. Shape (n, 2); empty for an empty mask.
    """
    height, width = mask.shape
    wide = width + 2
    padded = np.zeros((height + 2, wide), bool)
    padded[1:-1, 1:-1] = mask
    left = set(np.flatnonzero(padded).tolist())
    if not left:
        return np.empty((0, 2), np.intp)
    if entry is None:
        first = max(left)
    else:
        place = (entry[0] + 1) * wide + entry[1] + 1
        first = min(left, key=lambda k: (k // wide - place // wide) ** 2 + (k % wide - place % wide) ** 2)
    straight, oblique = (1, -1, wide, -wide), (wide + 1, wide - 1, -wide + 1, -wide - 1)
    came_from = {first: first}
    left.discard(first)
    # rings of about equal length: an oblique step counts one and a half, like every second straight one
    rings: list[list[int]] = [[first], [], [], []]
    last = first
    while any(rings):
        for pixel in rings[0]:
            last = pixel
            for steps, ring in ((straight, rings[2]), (oblique, rings[3])):
                for step in steps:
                    neighbour = pixel + step
                    if neighbour in left:
                        left.discard(neighbour)
                        came_from[neighbour] = pixel
                        ring.append(neighbour)
        rings = [*rings[1:], []]
    way = [last]
    while way[-1] != first:
        way.append(came_from[way[-1]])
    flat = np.array(way)
    return np.stack((flat // wide - 1, flat % wide - 1), axis=1)


def without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask (height, width) without its connected parts of fewer than `SPECK` pixels, which are no wire."""
    parts, _ = ndimage.label(mask, np.ones((3, 3)))
    enough = np.bincount(parts.ravel()) >= SPECK
    enough[0] = False
    return np.asarray(enough[parts])


def without_wire(image: NDArray[np.uint8], mask: NDArray[np.bool_]) -> Array:
    """The image with the wire's pixels filled from the columns beside it.

    Args:
        image: grey. Shape (height, width).
        mask: the wire's pixels. Shape (height, width).

    Returns:
        Grey levels. Shape (height, width).
    """
    hidden = mask.copy()
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        hidden |= np.roll(mask, shift, (0, 1))
    filled, columns = image.astype(float), np.arange(image.shape[1])
    for row in np.flatnonzero(hidden.any(axis=1)):
        seen = ~hidden[row]
        if seen.any():
            filled[row, ~seen] = np.interp(columns[~seen], columns[seen], filled[row, seen])
    return filled


def at_arcs(points: Array, arc: Array, arcs: Array) -> Array:
    """Places (k, d) at the arcs `arcs` (k,) of a curve (n, d) whose points lie at the arcs `arc` (n,)."""
    return np.stack([np.interp(arcs, arc, points[:, k]) for k in range(points.shape[1])], axis=1)


def smoothed(points: Array, window: int) -> Array:
    """A curve (n, d), each point averaged with those beside it, `window` of them at most.

    Both ends are continued by reflection through them, so that they stay where they are.
    """
    half = min(window, len(points)) // 2
    if not half:
        return points
    ahead, behind = 2 * points[0] - points[half:0:-1], 2 * points[-1] - points[-2 : -half - 2 : -1]
    longer = np.concatenate((ahead, points, behind))
    kernel = np.full(2 * half + 1, 1 / (2 * half + 1))
    return np.stack([np.convolve(longer[:, k], kernel, "valid") for k in range(points.shape[1])], axis=1)
