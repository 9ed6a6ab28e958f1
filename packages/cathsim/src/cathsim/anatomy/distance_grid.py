"""Signed distance to a vessel's wall on a regular grid, positive inside the lumen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class SignedDistanceGrid:
    """Distance to the wall, sampled at the corners of a regular lattice."""

    values: NDArray[np.float32]  # (nx, ny, nz) float32 m, C order; positive inside the lumen, clamped far outside
    origin: NDArray[np.float64]  # (3,) m, world position of values[0, 0, 0]
    spacing: float  # m between neighbours, the same along x, y and z

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        origin = np.asarray(self.origin, dtype=np.float64)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "origin", origin)
        if values.ndim != 3 or min(values.shape) < 2:
            raise ValueError(f"a distance grid needs at least 2 x 2 x 2 values, got shape {values.shape}.")
        if origin.shape != (3,):
            raise ValueError(f"a distance grid's origin must have shape (3,), got {origin.shape}.")
        if not self.spacing > 0:
            raise ValueError(f"a distance grid's spacing must be positive, got {self.spacing!r} m.")
        values.flags.writeable = False

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of lattice points along x, y and z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner (2, 3) m, world frame."""
        return np.stack([self.origin, self.origin + (np.array(self.shape) - 1) * self.spacing])

    def coordinates(self, indices: ArrayLike) -> NDArray[np.float64]:
        """World position (..., 3) m of lattice indices (..., 3), fractions allowed."""
        return self.origin + np.asarray(indices, dtype=np.float64) * self.spacing

    def sample(self, points: ArrayLike) -> NDArray[np.float64]:
        """Signed distance (...,) m at points (..., 3) m, trilinear, positive inside; clamped to the grid's border."""
        return sample_trilinear(self.values, self.origin, self.spacing, points)

    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        """Gradient (..., 3) of the signed distance at points (..., 3) m; at the wall about a unit vector inwards."""
        points = np.asarray(points, dtype=np.float64)
        half = 0.5 * self.spacing
        offsets = np.eye(3) * half
        return np.stack([(self.sample(points + o) - self.sample(points - o)) / (2 * half) for o in offsets], axis=-1)


def sample_trilinear(
    values: NDArray[np.float32], origin: NDArray[np.float64], spacing: float, points: ArrayLike
) -> NDArray[np.float64]:
    """Trilinear interpolation on a lattice; points outside take the border's value.

    Args:
        values: (nx, ny, nz), in any unit.
        origin: (3,) m, position of values[0, 0, 0].
        spacing: m.
        points: (..., 3) m.

    Raises:
        ValueError: points do not end in three coordinates.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.shape[-1:] != (3,):
        raise ValueError(f"points must have shape (..., 3), got {points.shape}.")
    limit = np.array(values.shape) - 1
    index = np.clip((points - origin) / spacing, 0.0, limit)
    base = np.minimum(index.astype(np.intp), limit - 1)
    fx, fy, fz = np.moveaxis(index - base, -1, 0)
    stride_x, stride_y = values.shape[1] * values.shape[2], values.shape[2]
    flat = values.reshape(-1)
    corner = base[..., 0] * stride_x + base[..., 1] * stride_y + base[..., 2]
    result = np.zeros(points.shape[:-1])
    for step_x, weight_x in ((0, 1 - fx), (stride_x, fx)):
        for step_y, weight_y in ((0, 1 - fy), (stride_y, fy)):
            weight = weight_x * weight_y
            lower = flat[corner + (step_x + step_y)]
            upper = flat[corner + (step_x + step_y + 1)]
            result += weight * (lower * (1 - fz) + upper * fz)
    return result


def bounding_box(mask: NDArray[np.bool_]) -> tuple[slice, slice, slice]:
    """The part of a lattice (nx, ny, nz) that holds all true nodes."""
    spans = []
    for axis in range(3):
        taken = np.flatnonzero(mask.any(axis=tuple(k for k in range(3) if k != axis)))
        spans.append(slice(int(taken[0]), int(taken[-1]) + 1))
    return spans[0], spans[1], spans[2]
