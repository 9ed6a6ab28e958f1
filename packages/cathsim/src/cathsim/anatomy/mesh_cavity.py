"""The lumen in a surface, as voxels: a closed cavity, or the tunnel that leads through a thick wall.

The surface is drawn into a lattice and everything else is flooded. What the flood does not reach from outside is
enclosed. An open vessel, or one in a thick wall, is reached; it is known by hardly any direction leading out of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .mesh_refusal import MeshRefusedError
from .mesh_samples import SurfaceSamples

_MARGIN = 4  # voxels of free space around the surface
_ESCAPING = 0.2  # of all directions may lead out of a tunnel
_LEAST_SPAN = 0.4  # of the surface's diagonal, which a lumen must span
_LEAST_RADIUS = 2.5  # voxels, of the widest ball in a lumen
_DIRECTIONS = tuple(
    step for step in product(range(-2, 3), repeat=3) if math.gcd(*step) == 1
)  # 98, about even over the sphere

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cavity:
    """Where a surface has its lumen.

    Attributes:
        inside: (nx, ny, nz) voxels of the lumen, the wall's own voxels left out.
        wall: (nx, ny, nz) voxels that the surface passes through.
        origin: (3,) m, middle of voxel (0, 0, 0).
        spacing: m between voxels.
        kind: "closed lumen", "lumen in a closed wall", or "tunnel".
        widest: m, radius of the widest ball inside.
    """

    inside: Mask
    wall: Mask
    origin: Array
    spacing: float
    kind: str
    widest: float

    def index(self, points: Array) -> NDArray[np.int64]:
        """Voxels (..., 3) that points (..., 3) m lie in; points outside the lattice get its border's."""
        index = np.rint((points - self.origin) / self.spacing).astype(np.int64)
        return np.clip(index, 0, np.array(self.inside.shape) - 1)

    def holds(self, mask: Mask, points: Array) -> Mask:
        """Whether points (..., 3) m lie in voxels of a mask."""
        i, j, k = np.moveaxis(self.index(points), -1, 0)
        found: Mask = mask[i, j, k]
        return found


def find_cavity(samples: SurfaceSamples, spacing: float) -> Cavity:
    """Finds the lumen of a surface whose borders are closed.

    Args:
        samples: points on the surface, at most half a voxel apart.
        spacing: m between voxels (or any other unit: nothing here depends on it).

    Returns:
        The lumen; at a tunnel's ends it stops about a radius before the opening.

    Raises:
        MeshRefusedError: where there is no lumen, or several that hang together nowhere.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt, label

    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    origin = low - _MARGIN * spacing
    shape = tuple(int(n) for n in np.ceil((high - low) / spacing).astype(int) + 2 * _MARGIN + 1)
    wall = np.zeros(shape, dtype=bool)
    i, j, k = np.rint((samples.points - origin) / spacing).astype(np.int64).T
    wall[i, j, k] = True
    diagonal = float(np.linalg.norm(high - low))

    def rooms(mask: Mask) -> list[tuple[float, float, Mask, tuple[slice, ...]]]:
        """Connected parts that span the surface, widest first: radius, volume, mask within a box, box."""
        from scipy.ndimage import find_objects

        labels, _ = label(mask)
        found = []
        for number, box in enumerate(find_objects(labels), start=1):
            span = float(np.linalg.norm([s.stop - s.start for s in box])) * spacing
            if span < _LEAST_SPAN * diagonal:
                continue
            part = labels[box] == number
            radius = float(distance_transform_edt(np.pad(part, 1)).max())
            if radius >= _LEAST_RADIUS:
                found.append((radius * spacing, float(part.sum()), part, box))
        return sorted(found, key=lambda room: -room[0])

    labels, _ = label(~wall)
    outside = labels == labels[0, 0, 0]
    enclosed = rooms(~wall & ~outside)
    tunnels = rooms(binary_dilation(_enclosed_voxels(wall) & outside, iterations=3, mask=outside))
    if tunnels and (not enclosed or tunnels[0][0] > 0.5 * enclosed[0][0] or tunnels[0][1] > 0.05 * enclosed[0][1]):
        kind, candidates = "tunnel", tunnels
    elif enclosed:
        kind, candidates = "closed lumen", enclosed
    else:
        raise MeshRefusedError(
            "no lumen was found: no cavity of the surface is enclosed over its length; "
            "expected the surface of a hollow vessel, closed or open at its ends."
        )
    radius, _, part, box = candidates[0]
    if kind == "closed lumen" and len(candidates) > 1:
        chosen = _innermost(candidates, labels.shape)
        if chosen is None:
            raise MeshRefusedError(
                f"the lumen falls into {len(candidates)} parts that do not hang together; join them, or give one of them."
            )
        kind, (radius, _, part, box) = "lumen in a closed wall", candidates[chosen]
    inside = np.zeros(shape, dtype=bool)
    inside[box] = part
    return Cavity(inside, wall, origin, spacing, kind, radius)


def _innermost(rooms: list[tuple[float, float, Mask, tuple[slice, ...]]], shape: tuple[int, ...]) -> int | None:
    """Which enclosed room all others surround, None where they lie side by side."""
    for number, (_, _, _, box) in enumerate(rooms):
        others = [other for k, (_, _, _, other) in enumerate(rooms) if k != number]
        if all(
            all(o.start <= s.start and s.stop <= o.stop for s, o in zip(box, other, strict=True)) for other in others
        ):
            return number
    return None


def _enclosed_voxels(wall: Mask) -> Mask:
    """Voxels, not quite up to the wall, that see walls in nearly all directions; judged on a lattice of half the fineness."""
    from scipy.ndimage import binary_dilation

    even = np.pad(wall, [(0, n % 2) for n in wall.shape])
    blocks = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, even.shape[2] // 2, 2).any(axis=(1, 3, 5))
    few = ~blocks & (_escapes(binary_dilation(blocks)) <= _ESCAPING * len(_DIRECTIONS))
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
