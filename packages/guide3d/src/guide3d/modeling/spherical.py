"""Spherical form of a curve: its tip, and the direction of each step of a fixed radius as two angles.

A step's direction is (sin θ cos φ, sin θ sin φ, cos θ) in a frame whose polar axis the curves avoid: near it φ means
nothing. φ is unwrapped along the curve from its far end: all wires come from the same side, while tips point
everywhere. So neighbouring curves have neighbouring angles, and a loop is a φ that has turned once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import ArrayLike
from torch import Tensor

from guide3d.geometry.polyline import Array, arc_length, at_length, checked
from guide3d.setting_kinds import Angle, Millimetres, settings

_ROUNDS = 8
_CANDIDATES = 400  # polar axes that are tried
_NEAR_POLE = np.radians(20.0)  # nearer to it a small turn of the wire is a large one of φ


def steps_of_radius(points_mm: ArrayLike, radius_mm: float) -> Array:
    """Walks along a curve in straight steps of the same length.

    Args:
        points_mm: (n, 3) curve, tip first.

    Returns:
        (m, 3) points, the tip first; the rest of less than a step is left out.

    Raises:
        ValueError: a curve of fewer than two points, or shorter than a step.
    """
    curve = checked(points_mm, 3, "curve")
    total = float(arc_length(curve)[-1])
    along = radius_mm * np.arange(int(total / radius_mm + 1e-9) + 1)
    if len(along) < 2:
        raise ValueError(f"expected a curve of at least {radius_mm} mm, got {total:.2f} mm")
    # A chord is shorter than its arc: each arc is stretched until its chord is a radius long.
    for _ in range(_ROUNDS):
        chords = np.linalg.norm(np.diff(at_length(curve, along), axis=0), axis=1)
        arcs = np.diff(along) * radius_mm / np.maximum(chords, 0.5 * radius_mm)
        along = np.concatenate(([0.0], np.cumsum(arcs)))
    return at_length(curve, along[along <= total + 1e-6])


def _half_sphere(count: int) -> Array:
    """(count, 3) directions, evenly spread: a Fibonacci lattice of one half."""
    place = np.arange(count) + 0.5
    height, turn = 1.0 - place / count, np.pi * (1.0 + np.sqrt(5.0)) * place
    radius = np.sqrt(1.0 - height**2)
    return np.stack((radius * np.cos(turn), radius * np.sin(turn), height), axis=1)


Direction = Annotated[float, Interval(ge=-1.001, le=1.001)]  # a component of a unit vector, rounded
Axis = tuple[Direction, Direction, Direction]


@settings
class SphericalForm:
    """How angles describe curves.

    Attributes:
        axes: (3, 3) orthonormal rows in the world; the last is the polar axis.
        azimuth: reference of φ, rad: opposite of where it is cut at the far end.
        polar: reference of θ, rad.
        cumulative: whether an angle is the offset from the step before (and of the first step from the reference), or
            of every step from the reference.
    """

    radius_mm: Millimetres
    axes: tuple[Axis, Axis, Axis]
    azimuth: Angle
    polar: Angle
    cumulative: bool = False

    def __post_init__(self) -> None:
        """Refuses axes that are no frame."""
        axes = np.asarray(self.axes)
        if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-4:
            raise ValueError(f"axes must be orthonormal rows, got {self.axes}")

    @classmethod
    def fit(cls, walks_mm: Sequence[Array], radius_mm: float, *, cumulative: bool = False) -> SphericalForm:
        """Chooses the frame for curves as `steps_of_radius` gives them."""
        directions = _half_sphere(_CANDIDATES)
        nearest = np.stack([np.abs(np.diff(walk, axis=0) @ directions.T).max(axis=0) for walk in walks_mm]) / radius_mm
        # Few curves come near the pole; among equals, it is far from what all curves do.
        near = (nearest > np.cos(_NEAR_POLE)).mean(axis=0)
        pole = directions[np.lexsort((nearest.mean(axis=0), near))[0]]
        first = np.eye(3)[np.argmin(np.abs(pole))]
        first = first - (first @ pole) * pole
        first /= np.linalg.norm(first)
        axes = np.stack((first, np.cross(pole, first), pole))
        ends = np.array([(walk[-1] - walk[-2]) @ axes.T for walk in walks_mm])
        azimuths = np.sort(np.arctan2(ends[:, 1], ends[:, 0]))
        gaps = np.diff(np.concatenate((azimuths, [azimuths[0] + 2 * np.pi])))
        cut = azimuths[np.argmax(gaps)] + gaps.max() / 2
        rows = tuple(tuple(float(x) for x in row) for row in axes)
        return cls(radius_mm, rows, float(cut - np.pi), float(np.pi / 2), cumulative)  # type: ignore[arg-type]

    def encode(self, walk_mm: Array) -> Array:
        """Turns a walk (n, 3) of `steps_of_radius` into offsets (Δφ, Δθ) (n - 1, 2), rad."""
        steps = np.diff(walk_mm, axis=0) @ np.asarray(self.axes).T
        azimuth = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        azimuth = azimuth - azimuth[-1] + (azimuth[-1] - self.azimuth + np.pi) % (2 * np.pi) - np.pi
        polar = np.arccos(np.clip(steps[:, 2] / np.linalg.norm(steps, axis=1), -1.0, 1.0)) - self.polar
        offsets = np.stack((azimuth, polar), axis=1)
        return np.diff(offsets, axis=0, prepend=0.0) if self.cumulative else offsets

    def decode(self, tip_mm: Tensor, offsets: Tensor) -> Tensor:
        """Integrates offsets (..., n - 1, 2), rad, from tips (..., 3) to points (..., n, 3), mm; differentiable."""
        walked = self.steps(offsets).cumsum(dim=-2)
        return torch.cat((tip_mm[..., None, :], tip_mm[..., None, :] + walked), dim=-2)

    def steps(self, offsets: Tensor) -> Tensor:
        """(..., n - 1, 2) offsets, rad, to (..., n - 1, 3) steps away from the tip, mm; differentiable."""
        if self.cumulative:
            offsets = offsets.cumsum(dim=-2)
        azimuth, polar = offsets[..., 0] + self.azimuth, offsets[..., 1] + self.polar
        sine = polar.sin()
        steps = torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), polar.cos()), dim=-1)
        axes = torch.tensor(self.axes, dtype=steps.dtype, device=steps.device)
        return self.radius_mm * steps @ axes
