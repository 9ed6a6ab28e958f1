"""Distortion of an image intensifier: a smooth analytic map of the image plane, and its inverse."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray

from cathsim.validation import Listed, Pixels, settings

Array = NDArray[np.float64]

_Coefficient = Annotated[float, Interval(ge=-10, le=10)]
_Pair = Annotated[tuple[_Coefficient, _Coefficient], Listed]
_ITERATIONS, _TOLERANCE_PX = 30, 1e-9
_DOMAIN = 1.6  # half image sides from the image's centre; the corners lie at 1.41


@settings
class DetectorDistortion:
    """Where the detector shows what a pinhole camera would see elsewhere.

    With x, y from `centre` in half image sides and r² = x² + y², an ideal point is shown at

        x (1 + pincushion r² + barrel r⁴) - y twist r² + 2 p1 x y + p2 (r² + 2 x²)
        y (1 + pincushion r² + barrel r⁴) + x twist r² + p1 (r² + 2 y²) + 2 p2 x y

    The input screen's curvature gives the pincushion, which the electron optics flatten towards the rim; the Earth's
    magnetic field gives the twist (the S distortion); a tilted tube the p terms.

    Raises:
        ValueError: where the map would fold the image over.
    """

    width: Pixels  # px
    height: Pixels  # px
    pincushion: _Coefficient = 0.0  # coefficient of r²
    barrel: _Coefficient = 0.0  # coefficient of r⁴
    twist: _Coefficient = 0.0  # rad at r = 1
    tilt: _Pair = (0.0, 0.0)  # (p1, p2)
    centre: _Pair = (0.0, 0.0)  # from the image's middle, half image sides; right and down

    def __post_init__(self) -> None:
        side = np.linspace(-_DOMAIN, _DOMAIN, 41)
        plane = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        disc = plane[np.hypot(*plane.T) <= _DOMAIN]
        stretch = np.linalg.det(self._map(disc - self.centre)[1])
        if stretch.min() < 0.1:
            raise ValueError(
                f"this distortion folds the image over (area scale {stretch.min():.2f} at the rim): use smaller "
                "coefficients."
            )

    @classmethod
    def none(cls, width: int, height: int) -> DetectorDistortion:
        """The identity, as of a flat panel."""
        return cls(width, height)

    @property
    def identity(self) -> bool:
        """Whether nothing moves."""
        return not any((self.pincushion, self.barrel, self.twist, *self.tilt))

    def resized(self, width: int, height: int) -> DetectorDistortion:
        """The same map over an image of another size (px) and the same shape."""
        return DetectorDistortion(width, height, self.pincushion, self.barrel, self.twist, self.tilt, self.centre)

    @property
    def _half(self) -> float:
        return min(self.width, self.height) / 2

    @property
    def _origin(self) -> Array:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2]) + self._half * np.asarray(self.centre)

    def _map(self, q: Array) -> tuple[Array, Array]:
        """Distorted positions (n, 2) and Jacobians (n, 2, 2) of normalised ideal positions."""
        x, y = q[:, 0], q[:, 1]
        r2, (p1, p2), twist = x * x + y * y, self.tilt, self.twist
        radial = 1 + r2 * (self.pincushion + self.barrel * r2)
        slope = 2 * (self.pincushion + 2 * self.barrel * r2)  # d radial / d x = slope x
        out = np.stack(
            (
                x * radial - y * twist * r2 + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + x * twist * r2 + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ),
            axis=-1,
        )
        jacobian = np.empty((len(q), 2, 2))
        jacobian[:, 0, 0] = radial + slope * x * x - 2 * twist * x * y + 2 * p1 * y + 6 * p2 * x
        jacobian[:, 0, 1] = slope * x * y - twist * (r2 + 2 * y * y) + 2 * p1 * x + 2 * p2 * y
        jacobian[:, 1, 0] = slope * x * y + twist * (r2 + 2 * x * x) + 2 * p1 * x + 2 * p2 * y
        jacobian[:, 1, 1] = radial + slope * y * y + 2 * twist * x * y + 6 * p1 * y + 2 * p2 * x
        return out, jacobian

    def distort(self, points: ArrayLike) -> Array:
        """Where the detector shows ideal points (n, 2) px, as a pinhole camera gives them.

        Returns:
            (n, 2) px in the image; exact where the map is: within 1.6 half image sides of the image's middle. What lies
            further out (never seen) is moved as its nearest point there, so that a line that leaves stays one line.

        Raises:
            ValueError: for another shape.
        """
        ideal = _pixels(points)
        if self.identity:
            return ideal.copy()
        q, beyond = self._normalised(ideal)
        return self._map(q)[0] * self._half + self._origin + beyond

    def _normalised(self, ideal: Array) -> tuple[Array, Array]:
        """Normalised positions held within the map's domain, and what was cut off, px."""
        middle = self._origin - self._half * np.asarray(self.centre)
        square = (ideal - middle) / self._half
        held = square * np.minimum(1.0, _DOMAIN / np.maximum(np.linalg.norm(square, axis=1, keepdims=True), 1e-12))
        return held - self.centre, (square - held) * self._half

    def jacobian(self, points: ArrayLike) -> Array:
        """Change (n, 2, 2) of the distorted (u, v) by that of the ideal (u, v) at ideal points (n, 2) px."""
        return self._map(self._normalised(_pixels(points))[0])[1]

    def undistort(self, points: ArrayLike) -> Array:
        """Where a pinhole camera would have seen points (n, 2) px of the image: the inverse of `distort`, to 1e-6 px.

        Raises:
            ValueError: for another shape, or points so far outside the image that the map does not reach them.
        """
        pixels = _pixels(points)
        if self.identity:
            return pixels.copy()
        target = (pixels - self._origin) / self._half
        q = target.copy()
        for _ in range(_ITERATIONS):
            at, jacobian = self._map(q)
            error = target - at
            if np.abs(error).max(initial=0.0) * self._half < _TOLERANCE_PX:
                return q * self._half + self._origin
            (a, b), (c, d) = jacobian.transpose(1, 2, 0)
            step = np.stack((d * error[:, 0] - b * error[:, 1], a * error[:, 1] - c * error[:, 0]), axis=-1)
            q = np.clip(q + step / (a * d - b * c)[:, None], -2.0, 2.0)
        bad = pixels[np.abs(target - self._map(q)[0]).max(axis=1) * self._half > _TOLERANCE_PX * 1e3]
        if len(bad):
            raise ValueError(
                f"a point lies too far outside the image to be undistorted: ({bad[0][0]:.0f}, {bad[0][1]:.0f}) px of "
                f"{self.width} x {self.height}: leave it out."
            )
        return q * self._half + self._origin

    def to_json(self) -> dict[str, Any]:
        """The coefficients and what they mean, as plain JSON values."""
        model = (
            "with x, y = (px - origin_px) / half_side_px: x' = x (1 + pincushion r2 + barrel r4) - y twist r2 "
            "+ 2 p1 x y + p2 (r2 + 2 x2); y' = y (1 + pincushion r2 + barrel r4) + x twist r2 + p1 (r2 + 2 y2) "
            "+ 2 p2 x y; ideal to distorted"
        )
        plain = {**asdict(self), "tilt": list(self.tilt), "centre": list(self.centre)}
        return {**plain, "model": model, "origin_px": self._origin.tolist(), "half_side_px": self._half}


def _pixels(points: ArrayLike) -> Array:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"image points must have shape (n, 2), got {array.shape}.")
    return array
