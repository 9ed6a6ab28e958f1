"""A smooth wall through coarse voxels: a level function of one vessel, zero at its wall, that keeps its volume.

Within a slice the distance to the vessel's outline is known; between slices it is interpolated, which turns steps into
slopes. The result is smoothed in rounds. After each the level is shifted so that within a few millimetres the vessel
holds what its voxels hold, and it is kept near the voxels.

Source of the interpolation between slices: Raya and Udupa, "Shape-based interpolation of multidimensional objects",
IEEE Transactions on Medical Imaging 9, 1990.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.volume.lumen.lattice import neighbours

_FINEST, _COARSEST = 6.5e-4, 9e-4  # m: voxels are joined until they are larger, and divided until they are smaller
_ANISOTROPIC = 1.3  # ratio of a voxel's sides from which on slices are interpolated
_ROUNDS = 5
_SMOOTHING = 0.75  # of the slices' distance, standard deviation of all rounds together
_LEAST_SMOOTHING, _MOST_SMOOTHING = 1.6e-3, 2.5e-3  # m
_OF_RADIUS = 0.5  # of a vessel's radius, by which it is smoothed at most
_FREEDOM = 7.5e-4  # m by which the wall may leave the interpolated one, or half a voxel
_WINDOW = 4e-3  # m, standard deviation of the neighbourhood that keeps its volume
_WINDOW_SLICES = 1.2  # slices, likewise
_STRIDE = 3  # cells between which volumes are compared
_CAP = 3.0  # slices, or radii of a narrow vessel, at which distances within a slice are cut off
_MARGIN = 5e-3  # m around the vessel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Field = NDArray[np.float32]


_LEAST_SHARE = 0.03  # of a vessel's voxels, from which on a part counts as lost
_LEAST_DEPTH = 0.6  # of the vessel's usual depth, likewise: a bar between two vessels is thinner
_USUAL = 0.98  # quantile of the depths of a vessel's voxels
_AROUND = 8e-3  # m about a lost part in which its way to the rest is looked for


@dataclass(frozen=True, eq=False)
class VesselField:
    """A level function of one vessel on a lattice along the volume's axes: about the distance to its wall, m."""

    values: Field  # (nx, ny, nz) m, positive inside
    origin: Array  # (3,) m, middle of the first cell in the axes of the box
    spacing: Array  # (3,) m

    def sample(self, points: Array) -> Field:
        """Values (n,) m at points (n, 3) m of the box's axes; far outside the lattice's lowest."""
        from scipy.ndimage import map_coordinates

        index = ((points - self.origin) / self.spacing).T
        return map_coordinates(self.values, index, order=1, mode="nearest", output=np.float32)

    @property
    def bounds(self) -> Array:
        """(2, 3) m, middles of the first and of the last cell."""
        return np.stack([self.origin, self.origin + (np.array(self.values.shape) - 1) * self.spacing])


def smooth_vessel(
    mask: Mask, spacing: Array, *, continued: tuple[tuple[bool, bool], ...] = ((False, False),) * 3
) -> VesselField:
    """Level function of one vessel.

    Args:
        mask: (nx, ny, nz) its voxels in a box.
        spacing: (3,) m between voxels.
        continued: whether the vessel goes on beyond the first and the last voxel along each axis, as one that the
            volume's edge cuts does.
    """
    from scipy.ndimage import gaussian_filter

    taken = [np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis))) for axis in range(3)]
    first = np.array([int(t[0]) for t in taken])
    crop = mask[tuple(slice(int(t[0]), int(t[-1]) + 1) for t in taken)]
    pads = [max(2, int(np.ceil(_MARGIN / s))) for s in spacing]
    ends = [
        (low and int(t[0]) == 0, high and int(t[-1]) == n - 1)
        for (low, high), t, n in zip(continued, taken, mask.shape, strict=True)
    ]
    for axis, (pad, (low, high)) in enumerate(zip(pads, ends, strict=True)):
        width = [(0, 0)] * 3
        width[axis] = (pad, 0)
        crop = np.pad(crop, width, mode="edge" if low else "constant")
        width[axis] = (0, pad)
        crop = np.pad(crop, width, mode="edge" if high else "constant")
    origin = (first - pads) * spacing
    share, factor = _pooled(crop, spacing)
    origin = origin + (np.array(factor) - 1) / 2 * spacing
    spacing = spacing * factor
    start = _outline_distance(share > 0.5, spacing)
    parts = np.array([max(1, int(np.ceil(side / _COARSEST - 1e-6))) for side in spacing])
    level, share = _divided(start, parts), _repeated(share, parts)
    origin = origin - spacing / 2 + spacing / parts / 2
    fine = spacing / parts
    thick = float(np.sort(spacing)[-1])
    radius = float(start.max())
    width_m = float(np.clip(_SMOOTHING * thick, _LEAST_SMOOTHING, _MOST_SMOOTHING))
    width_m = max(min(width_m, _OF_RADIUS * radius), 0.5 * float(fine.max()))
    freedom = np.float32(max(_FREEDOM, 0.5 * thick))
    low_bound, high_bound = level - freedom, level + freedom
    window = max(_WINDOW, _WINDOW_SLICES * thick) / fine
    for _ in range(_ROUNDS):
        level = gaussian_filter(level, width_m / np.sqrt(_ROUNDS) / fine, truncate=3.0, mode="nearest")
        level += _volume_shift(level, share, window, float(np.cbrt(np.prod(fine))))
        np.clip(level, low_bound, high_bound, out=level)
    level += _volume_shift(level, share, window, float(np.cbrt(np.prod(fine))))
    return VesselField(level, origin, fine)


def _pooled(mask: Mask, spacing: Array) -> tuple[Field, NDArray[np.int64]]:
    """Shares of a vessel in cells of whole numbers of voxels, and these numbers."""
    factor = np.array([max(1, int(_COARSEST / side)) if side < _FINEST else 1 for side in spacing])
    if (factor == 1).all():
        return mask.astype(np.float32), factor
    padded = np.pad(mask, [(0, -n % f) for n, f in zip(mask.shape, factor, strict=True)])
    nx, ny, nz = (n // f for n, f in zip(padded.shape, factor, strict=True))
    cells = padded.reshape(nx, factor[0], ny, factor[1], nz, factor[2])
    return cells.mean(axis=(1, 3, 5), dtype=np.float32), factor


def _outline_distance(mask: Mask, spacing: Array) -> Field:
    """Signed distance (m) of voxels to the outline, within slices where these lie far apart."""
    from scipy.ndimage import distance_transform_edt

    axis = int(np.argmax(spacing))
    thick, others = float(spacing[axis]), np.delete(spacing, axis)
    if thick < _ANISOTROPIC * float(others.min()):
        limit = _CAP * thick
        half = 0.5 * float(np.mean(spacing))
        inside = np.minimum(distance_transform_edt(mask, spacing), limit)
        outside = np.minimum(distance_transform_edt(~mask, spacing), limit)
        return np.where(mask, inside - half, half - outside).astype(np.float32)
    half = 0.5 * float(others.mean())
    slices = np.moveaxis(mask, axis, 0)
    inside = np.stack([distance_transform_edt(one, others) if one.any() else np.zeros(one.shape) for one in slices])
    # a narrow vessel that lies within slices is cut off at its own radius, so that it keeps its height
    cap = float(np.clip(np.quantile(inside.max(axis=(1, 2))[slices.any(axis=(1, 2))], 0.5), thick, _CAP * thick))
    level = np.full(slices.shape, -cap, dtype=np.float32)
    for one, within, row in zip(slices, inside, level, strict=True):
        if one.any():
            outside = distance_transform_edt(~one, others)
            row[:] = np.clip(np.where(one, within - half, half - outside), -cap, cap)
    return np.ascontiguousarray(np.moveaxis(level, 0, axis))


def _divided(level: Field, parts: NDArray[np.int64]) -> Field:
    """A field on cells divided into parts along every axis, linear between the cells' middles."""
    for axis, count in enumerate(parts.tolist()):
        if count > 1:
            n = level.shape[axis]
            at = np.clip((np.arange(n * count) + 0.5) / count - 0.5, 0, n - 1)
            base = np.minimum(at.astype(int), max(n - 2, 0))
            weight = (at - base).astype(np.float32)
            weight = weight.reshape([-1 if a == axis else 1 for a in range(3)])
            level = (
                np.take(level, base, axis) * (1 - weight) + np.take(level, np.minimum(base + 1, n - 1), axis) * weight
            )
    return level


def _repeated(share: Field, parts: NDArray[np.int64]) -> Field:
    for axis, count in enumerate(parts.tolist()):
        if count > 1:
            share = np.repeat(share, count, axis)
    return share


def _volume_shift(level: Field, share: Field, window: Array, cell: float) -> Field:
    """What to add to a level function so that it holds the voxels' volume in every neighbourhood."""
    from scipy.ndimage import gaussian_filter

    # a cell is taken to be filled in proportion to its level, over one cell's width
    filled = np.clip(level / np.float32(cell) + np.float32(0.5), 0, 1)
    slope = ((filled > 0) & (filled < 1)).astype(np.float32) / np.float32(cell)
    missing, area = _coarse_mean(share - filled), _coarse_mean(slope)
    small = window / _STRIDE
    missing, area = (gaussian_filter(a, small, truncate=2.5, mode="nearest") for a in (missing, area))
    shift = np.where(area > 1e-3 * area.max(), missing / np.maximum(area, 1e-3 * area.max()), 0.0).astype(np.float32)
    shift = np.clip(shift, -cell, cell)
    return _spread(shift, level.shape)


def _coarse_mean(values: Field) -> Field:
    pads = [(0, -n % _STRIDE) for n in values.shape]
    padded = np.pad(values, pads)
    nx, ny, nz = (n // _STRIDE for n in padded.shape)
    return padded.reshape(nx, _STRIDE, ny, _STRIDE, nz, _STRIDE).mean(axis=(1, 3, 5), dtype=np.float32)


def _spread(coarse: Field, shape: tuple[int, ...]) -> Field:
    """A field of coarse cells on the fine ones, linear between their middles."""
    fine = _divided(coarse, np.array([_STRIDE] * 3))
    return fine[: shape[0], : shape[1], : shape[2]]


def ways_to_lost(mask: Mask, main: Mask, spacing: Array) -> list[Array]:
    """Ways along a vessel's middle from what is kept of it to the far end of each part that is lost.

    Args:
        mask: (nx, ny, nz) the vessel's voxels in a box.
        main: (nx, ny, nz) those of them that lie in the lumen.
        spacing: (3,) m between voxels.

    Returns:
        For each part that is lost and hangs together with the rest by its voxels: (n, 3) m, middles of voxels in the
        axes of the box.
    """
    from scipy.ndimage import distance_transform_edt, label

    parts, count = label(mask & ~main, structure=np.ones((3, 3, 3)))
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
        way = _way(depth[window], main[window], parts[window] == number, spacing)
        if way is not None:
            ways.append((way + low) * spacing)
    return ways


def _way(depth: Array, main: Mask, lost: Mask, spacing: Array) -> NDArray[np.int64] | None:
    """Voxels (n, 3) from what is kept to the farthest of a lost part; None where no way leads there."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    voxels = np.argwhere(depth > 0)
    dear = (float(spacing.min()) / depth[tuple(voxels.T)]) ** 2
    pairs, lengths = neighbours(voxels, spacing)
    first, second = pairs.T
    graph = csr_matrix((lengths * (dear[first] + dear[second]), (first, second)), shape=(len(voxels),) * 2)
    ours, theirs = main[tuple(voxels.T)], np.flatnonzero(lost[tuple(voxels.T)])
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
    return voxels[way[::-1]]
