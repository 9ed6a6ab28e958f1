"""Signed distance to a vessel's wall on a regular lattice, positive inside the lumen, stored near the vessel only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.lattice.node_blocks import Box, NodeBlocks, Shape

OUTSIDE = -0.010  # m: signed distance far outside a lumen
_STEPS = 60
_NEAR = 2e-5  # m: nearer to the wall than this a ray has arrived

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LatticeField:
    """Values at the nodes of a regular lattice in space, such as distances to a target."""

    blocks: NodeBlocks  # the values, float32
    origin: NDArray[np.float64]  # (3,) m, world position of node (0, 0, 0)
    spacing: float  # m between neighbours, the same along x, y and z

    def __post_init__(self) -> None:
        origin = np.array(self.origin, dtype=np.float64)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise ValueError(f"a grid's origin must be finite and of shape (3,), got {origin.tolist()}.")
        if not 0 < self.spacing < np.inf:
            raise ValueError(f"a grid's spacing must be positive, got {self.spacing!r} m.")
        object.__setattr__(self, "origin", origin)

    @property
    def values(self) -> NDArray[np.float32]:
        """All values (nx, ny, nz) as a dense copy, read-only: of a large lattice that is much memory."""
        values = self.blocks.dense()
        values.flags.writeable = False
        return values

    def dense(self, box: Box | None = None) -> NDArray[np.float32]:
        """The values in a box of the lattice, three slices, as a dense copy; by default all."""
        return self.blocks.dense(box)

    @property
    def shape(self) -> Shape:
        """Number of lattice points along x, y and z."""
        return self.blocks.shape

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return self.blocks.nbytes

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner (2, 3) m, world frame."""
        return np.stack([self.origin, self.origin + (np.array(self.shape) - 1) * self.spacing])

    def coordinates(self, indices: ArrayLike) -> NDArray[np.float64]:
        """World position (..., 3) m of lattice indices (..., 3), fractions allowed."""
        return self.origin + np.asarray(indices, dtype=np.float64) * self.spacing

    def sample(self, points: ArrayLike) -> NDArray[np.float64]:
        """The value (...,) at points (..., 3) m, trilinear; clamped to the lattice's border.

        Raises:
            ValueError: points do not end in three coordinates.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), got {points.shape}.")
        return self.blocks.interpolated((points - self.origin) / self.spacing)

    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        """Gradient (..., 3) at points (..., 3) m; of a signed distance, at the wall, about a unit vector inwards."""
        points = np.asarray(points, dtype=np.float64)
        half = 0.5 * self.spacing
        offsets = np.eye(3) * half
        return np.stack([(self.sample(points + o) - self.sample(points - o)) / (2 * half) for o in offsets], axis=-1)


class SignedDistanceGrid(LatticeField):
    """Distance to the wall, m, positive inside the lumen, clamped far outside.

    Args:
        values: (nx, ny, nz) float32 m, dense or in blocks. Blocks that hold the least value everywhere, the clamp, are
            not stored.
        origin: (3,) m, world position of node (0, 0, 0).
        spacing: m between neighbours, the same along x, y and z.

    Raises:
        ValueError: fewer than 2 x 2 x 2 nodes, or an impossible origin or spacing.
    """

    def __init__(self, values: NDArray | NodeBlocks, origin: ArrayLike, spacing: float) -> None:
        shape = np.shape(values) if not isinstance(values, NodeBlocks) else values.shape
        if len(shape) != 3 or min(shape) < 2:
            raise ValueError(f"a distance grid needs at least 2 x 2 x 2 values, got shape {shape}.")
        if not isinstance(values, NodeBlocks):
            values = NodeBlocks.from_dense(np.asarray(values, dtype=np.float32))
        super().__init__(values, np.asarray(origin), spacing)

    @classmethod
    def from_nodes(
        cls,
        indices: ArrayLike,
        values: ArrayLike,
        shape: Shape,
        origin: ArrayLike,
        spacing: float,
        *,
        outside: float = OUTSIDE,
    ) -> SignedDistanceGrid:
        """A grid of which only the nodes near the lumen are given: no array of the whole box is made.

        Args:
            indices: (n, 3) whole numbers, within `shape`: all nodes of the lumen and those around it, as far as the
                distance to the wall is not the clamp.
            values: (n,) m, positive inside the lumen, none below `outside`.
            shape: number of nodes along x, y and z.
            outside: m, negative: the value of all other nodes, the clamp.

        Raises:
            ValueError: other shapes, an index outside the lattice, or a value below the clamp.
        """
        values = np.asarray(values, dtype=np.float32)
        if not outside < 0:
            raise ValueError(f"the distance outside must be negative, got {outside!r} m.")
        if values.size and not values.min() >= np.float32(outside):
            raise ValueError(f"no distance may be below that outside, {outside:g} m; the least is {values.min():g} m.")
        return cls(NodeBlocks.from_nodes(indices, values, shape, outside), origin, spacing)

    def coarser(self, stride: int) -> SignedDistanceGrid:
        """The grid of every `stride`-th node along each axis."""
        return SignedDistanceGrid(self.blocks.coarser(stride), self.origin, self.spacing * stride)

    def offset(self, distance: float) -> SignedDistanceGrid:
        """The grid of a lumen whose wall everywhere lies further out by a distance, m."""
        change = np.float32(distance)
        return SignedDistanceGrid(self.blocks.mapped(lambda values: values + change), self.origin, self.spacing)

    def with_values(self, indices: NDArray[np.integer], values: NDArray[np.float32]) -> SignedDistanceGrid:
        """The grid with other values (n,) m at some of the nodes (n, 3) that are stored: those above the clamp."""
        blocks = self.blocks
        own = blocks.own.copy()
        block = blocks.table[tuple((indices >> 3).T)] - 1
        own[(block, *(indices & 7).T)] = values
        changed = NodeBlocks.from_cores(blocks.stored, own, blocks.shape, float(blocks.constant))
        return SignedDistanceGrid(changed, self.origin, self.spacing)

    def moved(self, shift: ArrayLike) -> SignedDistanceGrid:
        """The same grid moved by (3,) m."""
        return SignedDistanceGrid(self.blocks, self.origin + np.asarray(shift), self.spacing)

    def inside(self) -> NDArray[np.int32]:
        """Indices (n, 3) of the lumen's nodes, in C order."""
        return self.blocks.where(lambda values: values > 0)[0]

    def inside_box(self) -> NDArray[np.int32]:
        """Lowest and highest index (2, 3) of the lumen's nodes."""
        return self.blocks.box_where(lambda values: values > 0)

    def silhouette(self, axis: int) -> NDArray[np.float32]:
        """The largest distance along an axis, (two others) m: positive where a line of sight meets the lumen."""
        return self.blocks.maximum_along(axis)

    def thickness(self, axis: int) -> NDArray[np.float64]:
        """Length (two others) m of every line of sight along an axis inside the lumen."""
        spacing = self.spacing
        return spacing * self.blocks.sum_along(axis, lambda values: np.clip(values / spacing + 0.5, 0.0, 1.0))


def across_frames(tangents: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) each, at right angles to tangents (n, 3) and to each other."""
    aside = np.where(np.abs(tangents[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = _cross(tangents, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, _cross(tangents, first)


def _cross(a: Array, b: Array) -> Array:
    """Cross products (n, 3); many times as fast as NumPy's for few vectors."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def plane_coordinates(points: Array, centre: Array, normal: Array) -> tuple[Array, Array]:
    """Heights (...) m of points (..., 3) m over a plane, along its unit normal, and distances (...) m from its axis."""
    offset = points - centre
    height = offset @ normal
    return height, np.linalg.norm(offset - height[..., None] * normal, axis=-1)


def in_cylinder(
    points: Array, centre: Array, normal: Array, heights: tuple[float, float], radius: float
) -> tuple[NDArray[np.int64], Array]:
    """Which of points (n, 3) m lie in a cylinder about a plane's unit normal, and how far (k,) m over the plane.

    Args:
        centre: (3,) m, of the plane, on the cylinder's axis.
        heights: m over the plane between which the cylinder lies.
        radius: m, of the cylinder.
    """
    offset = points - centre
    height = offset @ normal
    rows = np.flatnonzero((height > heights[0]) & (height < heights[1]))
    aside = np.linalg.norm(offset[rows] - height[rows, None] * normal, axis=1)
    rows = rows[aside < radius]
    return rows, height[rows]


def wall_distances(
    grid: SignedDistanceGrid, points: Array, tangents: Array, *, rays: int = 16, reach: float = 0.030
) -> tuple[Array, Array]:
    """Distances to the wall along rays within the planes across a vessel.

    Args:
        points: (n, 3) m, inside the lumen.
        tangents: (n, 3) unit vectors along the vessel.
        reach: m at which a ray ends that met no wall.

    Returns:
        Distances (rays, n) m, and the rays' unit vectors (rays, n, 3), evenly around the vessel.
    """
    first, second = across_frames(tangents)
    angles = np.arange(rays) * 2 * math.pi / rays
    directions = np.cos(angles)[:, None, None] * first + np.sin(angles)[:, None, None] * second
    travelled = np.zeros(directions.shape[:2])
    for _ in range(_STEPS):  # sphere tracing from within: never steps across the wall
        value = grid.sample(points + travelled[..., None] * directions)
        travelled = np.minimum(travelled + np.maximum(value, 0.0), reach)
        if float(np.max(np.where(travelled < reach, value, 0.0))) < _NEAR:
            break
    return travelled, directions
