"""The lumen of several vessels: one level function of all, open at take-offs, parted at false bridges, flat at ends."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import in_cylinder
from cathsim.anatomy.volume.labels.family import Family, Link
from cathsim.anatomy.volume.lumen.smoothing import VesselField, smooth_vessel

_INTO_PARENT = (3e-3, 8e-3)  # m that a vessel reaches into its parent at least and at most, its radius between
_PARTED = 1.2  # spacings between two vessels where a false bridge was cut
_CUT_REACH = 2e-3  # m around a false bridge within which they are parted
_CUT_FADING = 2.0  # m by m, how fast that ends further out
_NARROW = 0.8  # of a vessel's radius: a take-off narrower than this is widened to it
_ABOUT_OSTIUM = (2.0, 4e-3)  # radii of a take-off and m about it that show how wide the vessel is there
_CAP_WIDTH = 2.0  # radii aside of a vessel's axis within which its end is made flat

Array = NDArray[np.float64]
Box = NDArray[np.uint8]
Field = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FlatEnd:
    """A flat end of a vessel: beyond `base` its section there goes on up to a plane `beyond` further."""

    base: Array  # (3,) m, in the middle of the last full section
    normal: Array  # (3,) unit vector out of the vessel
    beyond: float  # m from the base to the plane
    radius: float  # m

    @property
    def centre(self) -> Array:
        """(3,) m, in the middle of the end."""
        return self.base + self.beyond * self.normal


@dataclass(eq=False)
class Union:
    """Level function of all vessels of a family, in the axes of the box."""

    fields: dict[int, VesselField]
    family: Family
    parted: float  # m between vessels where a false bridge is cut
    faces: list[tuple[int, float, float]]  # axis, place (m), and sign of the volume's faces that cut vessels
    ends: dict[int, list[FlatEnd]] = field(default_factory=dict)
    channels: dict[int, Array] = field(default_factory=dict)  # (n, 3) m, places of vessels that are kept open
    channel: float = 0.0  # m, the radius to which they are

    def level(self, points: Array) -> tuple[Field, NDArray[np.uint8]]:
        """Level (n,) m at points (n, 3) m, and the number of the vessel that each belongs to."""
        levels = {}
        for number, one in self.fields.items():
            low, high = one.bounds
            near = np.flatnonzero(
                np.logical_and.reduce([(x >= a) & (x <= b) for x, a, b in zip(points.T, low, high, strict=True)])
            )
            if len(near):
                levels[number] = (near, self._capped(number, points[near]))
        for a, b, places in self.family.false:
            if a in levels and b in levels:
                self._part(levels, a, b, places, points)
        best = np.full(len(points), -1.0, dtype=np.float32)
        which = np.zeros(len(points), dtype=np.uint8)
        for number, (near, values) in levels.items():
            higher = values > best[near]
            best[near[higher]] = values[higher]
            which[near[higher]] = number
        for axis, place, sign in self.faces:
            np.minimum(best, (sign * (place - points[:, axis])).astype(np.float32), out=best)
        return best, which

    def _capped(self, number: int, points: Array) -> Field:
        values = self.fields[number].sample(points)
        for end in self.ends.get(number, ()):
            heights = 0.0, 3 * end.radius + end.beyond
            beyond, height = in_cylinder(points, end.base, end.normal, heights, _CAP_WIDTH * end.radius)
            flat = self.fields[number].sample(points[beyond] - height[:, None] * end.normal)
            values[beyond] = np.minimum(flat, (end.beyond - height).astype(np.float32))
        if number in self.channels:
            from scipy.spatial import cKDTree

            away, _ = cKDTree(self.channels[number]).query(points, distance_upper_bound=2 * self.channel)
            near = np.flatnonzero(np.isfinite(away))
            values[near] = np.maximum(values[near], (self.channel - away[near]).astype(np.float32))
        return values

    def _part(self, levels: dict[int, tuple[NDArray, Field]], a: int, b: int, places: Array, points: Array) -> None:
        from scipy.spatial import cKDTree

        (rows_a, values_a), (rows_b, values_b) = levels[a], levels[b]
        both, at_a, at_b = np.intersect1d(rows_a, rows_b, assume_unique=True, return_indices=True)
        low, high = places.min(axis=0) - 3 * _CUT_REACH, places.max(axis=0) + 3 * _CUT_REACH
        near = ((points[both] >= low) & (points[both] <= high)).all(axis=1)
        both, at_a, at_b = both[near], at_a[near], at_b[near]
        if len(both) == 0:
            return
        away = cKDTree(places).query(points[both])[0]
        gap = (self.parted - _CUT_FADING * np.maximum(away - _CUT_REACH, 0.0)).astype(np.float32)
        first, second = values_a[at_a].copy(), values_b[at_b].copy()
        values_a[at_a] = np.minimum(first, (first - second - gap) / 2)
        values_b[at_b] = np.minimum(second, (second - first - gap) / 2)


def unite(
    box: Box, family: Family, spacing: Array, first: tuple[int, ...], shape: tuple[int, ...], resolution: float
) -> Union:
    """Smooths every vessel and unites them.

    Args:
        box: (nx, ny, nz) numbers of vessels.
        spacing: (3,) m between voxels.
        first, shape: indices of the box's first voxel in the volume, and the volume's voxels.
        resolution: m, of the lattice on which the level will be taken.
    """
    edges = tuple((f == 0, f + n == s) for f, n, s in zip(first, box.shape, shape, strict=True))
    fields = {}
    for number in family.order:
        mask = box == number
        if number in family.links:
            link = family.links[number]
            reach = float(np.clip(link.radius, *_INTO_PARENT))
            parent = box == link.beside
            _reach_into(mask, parent, link.ostium, reach, spacing)
            if widened := _open_take_off(mask, box, number, link, spacing):
                family.notes.append(f"the take-off of {family.names[number]} {widened}")
        fields[number] = smooth_vessel(mask, spacing, continued=edges)
    faces = []
    for axis, (low, high) in enumerate(edges):
        if low:
            faces.append((axis, -0.5 * float(spacing[axis]), -1.0))
        if high:
            faces.append((axis, (box.shape[axis] - 0.5) * float(spacing[axis]), 1.0))
    return Union(fields, family, _PARTED * resolution, faces)


def _reach_into(
    mask: NDArray[np.bool_], parent: NDArray[np.bool_], ostium: Array, reach: float, spacing: Array
) -> None:
    """Adds the parent's voxels near a take-off to a vessel's, so that no wall stands between the two."""
    from scipy.spatial import cKDTree

    low = np.maximum(np.floor((ostium.min(axis=0) - reach) / spacing).astype(int), 0)
    high = np.ceil((ostium.max(axis=0) + reach) / spacing).astype(int) + 1
    window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    places = np.argwhere(parent[window])
    if len(places):
        away = cKDTree(ostium).query((places + low) * spacing)[0]
        mask[window][tuple(places[away <= reach].T)] = True


def _open_take_off(mask: NDArray[np.bool_], box: Box, number: int, link: Link, spacing: Array) -> str:
    """Widens a take-off that is much narrower than its vessel, as labels that touch by few voxels leave it.

    Returns:
        What was done, for a note; nothing where it is wide enough.
    """
    from scipy.ndimage import distance_transform_edt

    centre = link.ostium.mean(axis=0)
    about = _ABOUT_OSTIUM[0] * link.radius + _ABOUT_OSTIUM[1]
    window, low = _window(centre - 2 * about, centre + 2 * about, spacing, box.shape)
    own = box[window] == number
    if not own.any():
        return ""
    depth = distance_transform_edt(np.pad(own, 1), spacing)[1:-1, 1:-1, 1:-1]
    places = np.argwhere(own)
    near = places[np.linalg.norm((places + low) * spacing - centre, axis=1) <= 2 * about]
    radius = float(depth[tuple(near.T)].max())
    if link.radius >= _NARROW * radius:
        return ""
    away = np.linalg.norm((near + low) * spacing - centre, axis=1)
    inside = near[np.abs(away - (radius + link.radius)) <= radius]
    if len(inside) == 0:
        return ""
    onward = (inside + low).mean(axis=0) * spacing - centre
    onward /= max(float(np.linalg.norm(onward)), 1e-12)
    start, end = centre - 2 * radius * onward, centre + 1.5 * radius * onward
    window, low = _window(np.minimum(start, end) - radius, np.maximum(start, end) + radius, spacing, box.shape)
    points = (np.stack(np.meshgrid(*[np.arange(s.start, s.stop) for s in window], indexing="ij"), -1)) * spacing - start
    along = np.clip(points @ (end - start) / float((end - start) @ (end - start)), 0.0, 1.0)
    tube = np.linalg.norm(points - along[..., None] * (end - start), axis=-1) <= 0.95 * radius
    free = (box[window] == 0) | (box[window] == link.beside)
    mask[window] |= tube & free
    return f"has {1e3 * link.radius:.1f} mm of radius in the labels, it is widened to {1e3 * radius:.1f}"


def _window(
    low: Array, high: Array, spacing: Array, shape: tuple[int, ...]
) -> tuple[tuple[slice, slice, slice], NDArray]:
    """The part of a box between two corners (3,) m, and its first voxel."""
    first = np.clip(np.floor(low / spacing).astype(int), 0, np.array(shape) - 1)
    last = np.clip(np.ceil(high / spacing).astype(int) + 1, 1, shape)
    i, j, k = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
    return (i, j, k), first
