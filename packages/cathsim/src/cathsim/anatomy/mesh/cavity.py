"""The lumen in a surface, as voxels: a closed cavity, or the tunnel that leads through a thick wall.

The surface is drawn into a lattice and everything else is flooded. What the flood does not reach from outside is
enclosed. An open vessel, or one in a thick wall, is reached; it is known by hardly any direction leading out of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.lattice import dilated
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.samples import SurfaceSamples

_MARGIN = 4  # voxels of free space around the surface
_ESCAPING = 0.2  # of all directions may lead out of a tunnel
_LEAST_SPAN = 0.4  # of the surface's diagonal, which a lumen must span
_PART_SPAN = 0.4  # of that, from which on a piece counts as a part of the lumen that was torn off ...
_PART_SHARE = 0.05  # ... if it has this share of its volume
_WALL_SHARE = 0.4  # of an enclosed hollow's radius: if a tunnel's is larger, that hollow is the tunnel's wall
_COVERED = 0.85  # of a lumen's border lies at its wall, but for its ends
_WOUND = 0.7  # turns of the surface about a place, from which on it lies within it
_GROWN = 3  # voxels by which a tunnel is grown up to its wall
_LEAST_RADIUS = 2.5  # voxels, of the widest ball in a lumen
_FINE_HOLLOW = 4_000_000  # voxels of a hollow's box up to which its widest ball is measured on all of them
_DIRECTIONS = tuple(
    step for step in product(range(-2, 3), repeat=3) if math.gcd(*step) == 1
)  # 98, about even over the sphere

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cavity:
    """Where a surface has its lumen."""

    inside: Mask  # (nx, ny, nz) voxels of the lumen, the wall's own voxels left out
    wall: Mask  # (nx, ny, nz) voxels that the surface passes through
    origin: Array  # (3,) m, middle of voxel (0, 0, 0)
    spacing: float  # m between voxels
    kind: str  # "closed lumen", "lumen in a closed wall", or "tunnel"
    widest: float  # m, radius of the widest ball inside

    @cached_property
    def thick_wall(self) -> Mask:
        """The wall's voxels (nx, ny, nz), thickened so that no ray slips through."""
        return dilated(self.wall)

    def index(self, points: Array) -> NDArray[np.int64]:
        """Voxels (..., 3) that points (..., 3) m lie in; points outside the lattice get its border's."""
        steps = points - self.origin
        steps /= self.spacing
        index = np.rint(steps, out=steps).astype(np.int64)
        return np.clip(index, 0, np.array(self.inside.shape) - 1, out=index)

    def holds(self, mask: Mask, points: Array) -> Mask:
        """Whether points (..., 3) m lie in voxels of a mask."""
        i, j, k = np.moveaxis(self.index(points), -1, 0)
        return mask[i, j, k]


@dataclass(frozen=True, eq=False)
class _Hollow:
    """A connected part of the lattice: its voxels within a box, widest ball and extent in voxels."""

    part: Mask
    box: tuple[slice, ...]
    radius: float
    span: float

    @property
    def volume(self) -> int:
        return int(np.count_nonzero(self.part))

    def whole(self, shape: tuple[int, ...]) -> Mask:
        """Its voxels on the whole lattice."""
        mask = np.zeros(shape, dtype=bool)
        mask[self.box] = self.part
        return mask


def find_cavity(samples: SurfaceSamples, spacing: float, *, rough: bool = False) -> Cavity:
    """Finds the lumen of a surface whose borders are closed; at a tunnel's ends it stops somewhat before the opening.

    Args:
        samples: points on the surface, at most 0.7 voxels apart.
        spacing: m between voxels.
        rough: only its widest place is wanted: narrow places may be shut at this spacing, so that parts beyond them
            are no fault, and lengths may be in any unit, so that an error must not name them.

    Raises:
        MeshRefusedError: there is no lumen, or several that are not connected.
    """
    from scipy.ndimage import label

    wall, origin = _drawn(samples, spacing)
    diagonal = float(np.linalg.norm(np.ptp(samples.bounds, axis=0)))
    labels, _ = label(~wall)
    outside = labels == labels[0, 0, 0]
    span = _LEAST_SPAN * diagonal / spacing
    enclosed = _hollows(~wall & ~outside, span)
    grown = _enclosed_voxels(wall) & outside
    for _ in range(_GROWN):
        grown = dilated(grown) & outside
    tunnels = _hollows(grown, span)
    deep = [hollow for hollow in enclosed if _is_lumen(hollow, span)]
    through = [hollow for hollow in tunnels if _is_lumen(hollow, span)]
    # Hollows between vessels pass for narrow tunnels: a lumen is not much narrower than what it lies in.
    if through and (not deep or through[0].radius - _GROWN > _WALL_SHARE * deep[0].radius):
        kind, region, rivals = "tunnel", through[0], [r for r in tunnels if r.radius > 0.4 * through[0].radius]
    elif deep:
        kind, region, rivals = "closed lumen", deep[0], enclosed
        around = [r for r in deep[1:] if _surrounds(r, region, wall.shape) or _covers(r, region, wall.shape)]
        within = [hollow for hollow in deep[1:] if _surrounds(region, hollow, wall.shape)]
        if around or within:
            kind, region = "lumen in a closed wall", within[0] if within else region
        rivals = [hollow for hollow in rivals if hollow not in [*around, *within]]
    else:
        raise MeshRefusedError(_why_none([*enclosed, *tunnels], span, spacing, rough=rough))
    rivals = [r for r in rivals if r.radius >= _LEAST_RADIUS and r.volume >= _PART_SHARE * region.volume]
    if len(rivals) > 1 and abs(_winding(region, samples, origin, spacing)) > _WOUND:
        # a hollow between vessels lies outside of the surface, a part of the lumen that was torn off within it
        rivals = [r for r in rivals if r is region or abs(_winding(r, samples, origin, spacing)) > 1 - _WOUND]
    if len(rivals) > 1 and not rough:
        raise falls_apart([spacing * (np.array([s.stop - s.start for s in hollow.box])) for hollow in rivals])
    return Cavity(region.whole(wall.shape), wall, origin, spacing, kind, region.radius * spacing)


def falls_apart(sides: Sequence[Array]) -> MeshRefusedError:
    """The refusal of a lumen in parts, by their sides (3,) m."""
    sizes = ", ".join(" x ".join(f"{1e3 * side:.0f}" for side in part) for part in sides)
    return MeshRefusedError(
        f"the lumen falls into {len(sides)} parts that do not hang together ({sizes} mm): leave out veins and arteries "
        "that are not the aorta's, and join what belongs to it."
    )


def enclosed_by(samples: SurfaceSamples, spacing: float) -> Cavity | None:
    """All that a surface encloses, whatever its shape; None where that is nothing."""
    from scipy.ndimage import distance_transform_edt, label

    wall, origin = _drawn(samples, spacing)
    labels, _ = label(~wall)
    inside = (labels != labels[0, 0, 0]) & ~wall
    if not inside.any():
        return None
    return Cavity(inside, wall, origin, spacing, "closed lumen", float(distance_transform_edt(inside).max()) * spacing)


def _drawn(samples: SurfaceSamples, spacing: float) -> tuple[Mask, Array]:
    """The voxels that a surface passes through, and the middle (3,) of voxel (0, 0, 0)."""
    low, high = samples.bounds
    origin = low - _MARGIN * spacing
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / spacing).astype(int) + 2 * _MARGIN + 1)
    wall = np.zeros((nx, ny, nz), dtype=bool)
    i, j, k = (
        np.rint((axis - first) / spacing).astype(np.int64) for axis, first in zip(samples.points.T, origin, strict=True)
    )
    wall[i, j, k] = True
    return wall, origin


def largest_part(mask: Mask, structure: NDArray[Any] | None = None) -> Mask:
    """The largest connected part of a mask (nx, ny, nz)."""
    from scipy.ndimage import label

    labels, count = label(mask, structure)
    if count < 2:
        return mask
    sizes = np.bincount(labels.reshape(-1))
    sizes[0] = 0
    return labels == int(np.argmax(sizes))


def _hollows(mask: Mask, span: float) -> list[_Hollow]:
    """Connected parts that are not much shorter than a span, widest first."""
    from scipy.ndimage import distance_transform_edt, find_objects, label

    labels, _ = label(mask)
    hollows = []
    for number, box in enumerate(find_objects(labels), start=1):
        extent = float(np.linalg.norm([s.stop - s.start for s in box]))
        if extent >= _PART_SPAN * span:
            part = labels[box] == number
            step = 1 if part.size < _FINE_HOLLOW else 2  # the widest ball is large there
            radius = step * float(distance_transform_edt(np.pad(part[::step, ::step, ::step], 1)).max())
            hollows.append(_Hollow(part, box, radius, extent))
    return sorted(hollows, key=lambda hollow: -hollow.radius)


def _is_lumen(hollow: _Hollow, span: float) -> bool:
    return hollow.span >= span and hollow.radius >= _LEAST_RADIUS


def _winding(hollow: _Hollow, samples: SurfaceSamples, origin: Array, spacing: float) -> float:
    """Solid angle of the surface about a hollow's middle, in whole turns: 1 or -1 within it, 0 outside of it.

    Holes take little from it. (A. Jacobson et al., "Robust inside-outside segmentation using generalized winding
    numbers", ACM Transactions on Graphics 32(4), 2013; a triangle's solid angle by A. van Oosterom and J. Strackee,
    IEEE Transactions on Biomedical Engineering 30(2), 1983.)
    """
    from scipy.ndimage import distance_transform_edt

    depth = distance_transform_edt(np.pad(hollow.part, 1))
    place = np.array(np.unravel_index(int(np.argmax(depth)), depth.shape)) - 1 + [s.start for s in hollow.box]
    a, b, c = (samples.corners - (origin + spacing * place)).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(np.arctan2(volume, below).sum()) / (2 * math.pi)


def _surrounds(outer: _Hollow, inner: _Hollow, shape: tuple[int, ...]) -> bool:
    """Whether a hollow lies all around another, walls between them left out of account."""
    from scipy.ndimage import binary_dilation, binary_fill_holes

    shell = binary_dilation(outer.whole(shape), iterations=3)
    return bool(binary_fill_holes(shell)[inner.box][inner.part].mean() > 0.95)


def _covers(wall: _Hollow, lumen: _Hollow, shape: tuple[int, ...]) -> bool:
    """Whether a hollow is the wall of a lumen, left open at the ends: a thin layer at most of its border."""
    from scipy.ndimage import binary_dilation, binary_erosion

    if wall.radius > _WALL_SHARE * lumen.radius:
        return False
    near = binary_dilation(wall.whole(shape), iterations=3)[lumen.box]
    return bool(near[lumen.part & ~binary_erosion(lumen.part)].mean() > _COVERED)


def _why_none(hollows: list[_Hollow], span: float, spacing: float, *, rough: bool) -> str:
    long = [hollow.radius for hollow in hollows if hollow.span >= span]
    if not long:
        return (
            "no lumen was found: no cavity of the surface is enclosed over its length; "
            "expected the surface of a hollow vessel, closed or open at its ends."
        )
    width, needed = 2 * max(long), 2 * _LEAST_RADIUS
    measured = (
        f"it is {width * spacing * 1e3:.1f} mm wide, {needed * spacing * 1e3:.1f} mm are needed at this resolution"
    )
    relative = f"it is {width / span * _LEAST_SPAN:.1%} of the whole's size wide"
    return f"the lumen is too narrow for a wire: at its widest {relative if rough else measured}."


def _enclosed_voxels(wall: Mask) -> Mask:
    """Voxels, not quite up to the wall, that see walls in most directions; found at half the resolution."""
    even = np.pad(wall, [(0, n % 2) for n in wall.shape])
    pairs = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, even.shape[2] // 2, 2)
    blocks: Mask = np.logical_or.reduce(pairs, axis=(1, 3, 5))
    few = ~blocks & (_escapes(dilated(blocks)) <= _ESCAPING * len(_DIRECTIONS))
    for axis in range(3):
        few = np.repeat(few, 2, axis=axis)
    return few[: wall.shape[0], : wall.shape[1], : wall.shape[2]]


def _escapes(wall: Mask) -> NDArray[np.uint8]:
    """In how many of the directions each voxel sees no wall."""
    seen = np.zeros(wall.shape, dtype=np.uint8)
    for step in _DIRECTIONS:
        axis = int(np.argmax(np.abs(step)))
        stride = abs(step[axis])
        order = np.arange(wall.shape[axis])
        if step[axis] > 0:
            order = order[::-1]
        others = [step[k] for k in range(3) if k != axis]
        slabs = np.moveaxis(wall, axis, 0)
        counts = np.moveaxis(seen, axis, 0)
        size = slabs.shape[1:]
        source = tuple(slice(max(o, 0), n + min(o, 0)) for n, o in zip(size, others, strict=True))
        goal = tuple(slice(max(-o, 0), n + min(-o, 0)) for n, o in zip(size, others, strict=True))
        ahead = [np.zeros(size, dtype=bool) for _ in range(stride)]  # where rays met walls, of the slabs ahead
        for index in order:
            hit = np.zeros(size, dtype=bool)
            hit[goal] = ahead.pop(0)[source]
            counts[index] += ~hit
            ahead.append(hit | slabs[index])
    return seen
