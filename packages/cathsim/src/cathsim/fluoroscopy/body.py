"""The patient around the vessels: tissue, lungs and spine as ellipsoids with an attenuation each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .projector import Projector


@dataclass(frozen=True)
class Ellipsoid:
    """A solid of uniform extra attenuation; solids add where they overlap.

    Attributes:
        centre: m, from the phantom's centre, along the world's axes.
        semi_axes: m, along the world's axes.
        attenuation: 1/m, added to what the solid lies in; negative for air in tissue.
    """

    centre: tuple[float, float, float]
    semi_axes: tuple[float, float, float]
    attenuation: float

    def __post_init__(self) -> None:
        if min(self.semi_axes) <= 0:
            raise ValueError(f"an ellipsoid's semi-axes must be positive, got {self.semi_axes} m.")


def _spine() -> tuple[Ellipsoid, ...]:
    """A column of bone with a denser body at each vertebra."""
    column = Ellipsoid((0.0, 0.060, 0.0), (0.016, 0.017, 0.60), 4.0)
    vertebrae = (Ellipsoid((0.0, 0.060, 0.026 * i), (0.020, 0.017, 0.0125), 5.0) for i in range(-7, 8))
    return (column, *vertebrae)


def _lung(side: float) -> tuple[Ellipsoid, ...]:
    """A lung whose border is soft in the picture, as several of different size."""
    return tuple(
        Ellipsoid((side * 0.118, 0.0, -0.045), (width, 0.085, height), -0.8)
        for width, height in ((0.078, 0.165), (0.070, 0.152), (0.061, 0.139))
    )


# Linear attenuation near 60 keV is 20.5 per metre in soft tissue. Lungs and bone stand out less than in life: the image
# spends its grey levels on vessel and wire.
THORAX: tuple[Ellipsoid, ...] = (
    Ellipsoid((0.0, 0.0, 0.0), (0.19, 0.115, 0.60), 20.5),
    *_lung(-1.0),
    *_lung(1.0),
    *_spine(),
)


def body_depth(projector: Projector, body: tuple[Ellipsoid, ...], origin: NDArray[np.float64]) -> NDArray[np.float32]:
    """Optical depth of a body along the ray of every pixel.

    Args:
        projector: the camera.
        body: its solids.
        origin: (3,) m, where the body's own origin stands in the world.

    Returns:
        (height, width), dimensionless.
    """
    u, v = np.meshgrid(np.arange(projector.width, dtype=np.float64), np.arange(projector.height, dtype=np.float64))
    directions = np.stack([u, v, np.ones_like(u)], axis=-1) @ projector.rays.T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    depth = np.zeros(u.shape)
    for solid in body:
        # in the space where the solid is the unit sphere, a ray start + s * direction is a quadratic in s
        axes = np.asarray(solid.semi_axes)
        start = (projector.source - origin - np.asarray(solid.centre)) / axes
        along = directions / axes
        a = np.einsum("...i,...i->...", along, along)
        b = along @ start
        chord = 2 * np.sqrt(np.maximum(b * b - a * (start @ start - 1.0), 0.0)) / a
        depth += solid.attenuation * chord
    return depth.astype(np.float32)
