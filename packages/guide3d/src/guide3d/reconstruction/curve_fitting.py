"""The smooth curve in space that passes through both annotations, with the uncertainty of each of its points.

Unknown is a uniform cubic B-spline. An annotated point says that the curve's image passes it, not where along the
curve it lies: its residual is the distance across, and its place along follows the curve (the tip alone is a point in
both images). So matching decides which branch belongs to which, and no more. Where a wire runs along the epilines the
images leave its depth open; there the prior decides: a wire is stiff. Its curvature, and the change of its curvature
along the wire, have heavy-tailed priors, which keep shafts straight and let hooks be hooks. Gauss-Newton (compiled)
finds the most probable curve; the noise of the annotation is estimated with it; the inverse of the normal matrix is
the covariance.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solveh_banded
from scipy.special import erfcx

from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array, arc_length, at_length
from guide3d.native_library import ImageStruct, PriorStruct, SplineStruct, address, library

# What is known of a wire and of its annotation beforehand.
PITCH_MM = 4.0  # distance of the spline's knots
NOISE_PX = 1.0  # noise of an annotated point in each coordinate, to start from
LEAST_NOISE_PX = 0.15  # least noise an estimate may have
OUTLIER = 3.0  # in noises, the distance at which an annotated point has lost half its weight
BENDING_PER_MM = 3e-4  # spectral density of the curvature (1/mm)^2 mm; smaller is stiffer
BEND_PER_MM = 0.01  # curvature beyond which more bending costs ever less
CHANGING_PER_MM3 = 1e-5  # spectral density of the curvature's derivative
CHANGE_PER_MM2 = 2e-3  # derivative of the curvature beyond which more change costs ever less
SPEED = 0.2  # how far the parameter may deviate from arc length, relative, per square root of mm
MARGIN_MM = 10.0  # how far the spline reaches beyond the matched end
ITERATIONS = 25


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """A wire in space.

    spline: mm; its parameter is nearly the arc length
    end: parameter at which the wire leaves the image that it leaves first
    band: (3 n, 12) covariance of the control points, mm^2: element (j + k, j) at [j, k]
    along: per view, parameter of each annotated point
    noise_px: noise of the annotation, as estimated
    """

    spline: BSplineCurve
    end: float
    band: Array
    along: tuple[Array, Array]
    noise_px: float

    def sample(self, spacing_mm: float) -> tuple[Array, Array]:
        """Returns points (n, 3) mm at equal arc length from the tip and their covariances (n, 3, 3) mm^2.

        A point of a curve that is longer up to there lies farther back on it: what the length varies by is taken off
        along the tangent, so that the parameter, which slides, has no part in it.
        """
        fine = np.linspace(0.0, self.end, max(2, int(4 * self.end / spacing_mm)))
        line = self.spline.at(fine)
        along = arc_length(line)
        lengths = spacing_mm * np.arange(int(along[-1] / spacing_mm + 1e-9) + 1)
        u = np.interp(lengths, along, fine)
        tangent = self.spline.at(u + 1e-3) - self.spline.at(u - 1e-3)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)

        cell, value = self._basis(fine)
        basis = np.zeros((len(fine), len(self.spline.coefficients)))
        np.put_along_axis(basis, cell[:, None] + np.arange(4), value, axis=1)
        chords = np.diff(line, axis=0) / np.maximum(np.diff(along), 1e-12)[:, None]
        by_point = np.zeros((*basis.shape, 3))  # derivative of the arc length by each control point
        np.cumsum(np.diff(basis, axis=0)[:, :, None] * chords[:, None], axis=0, out=by_point[1:])
        place = np.interp(lengths, along, np.arange(len(along)))
        first = np.minimum(place.astype(int), len(along) - 2)
        share = (place - first)[:, None, None]
        by_point = ((1 - share) * by_point[first] + share * by_point[first + 1]).reshape(len(u), -1)

        with_points = by_point @ self._whole_covariance()
        of_length = np.einsum("ni,ni->n", with_points, by_point)
        cell, value = self._basis(u)
        four = cell[:, None, None] + np.arange(4)[:, None]
        moved = np.take_along_axis(with_points.reshape(len(u), -1, 3), four, axis=1)
        mixed = np.einsum("na,nad->nd", value, moved)[:, None] * tangent[:, :, None]
        squared = of_length[:, None, None] * tangent[:, :, None] * tangent[:, None]
        return self.spline.at(u), self.covariance(u) - mixed - mixed.transpose(0, 2, 1) + squared

    def _whole_covariance(self) -> Array:
        """The covariance (3 n, 3 n) of control points: given three in a row, later ones depend on no earlier one."""
        size = self.spline.coefficients.size
        whole = np.zeros((size, size))
        for j in range(12):
            i = np.arange(size - j)
            whole[i + j, i] = whole[i, i + j] = self.band[: size - j, j]
        for k in range(12, size, 3):
            before = slice(k - 9, k)
            by_three = np.linalg.solve(whole[before, before], whole[before, k : k + 3]).T
            whole[k : k + 3, : k - 9] = by_three @ whole[before, : k - 9]
            whole[: k - 9, k : k + 3] = whole[k : k + 3, : k - 9].T
        return whole

    def _basis(self, u: Array) -> tuple[NDArray[np.int64], Array]:
        return _basis(u, self.spline.knots[4] - self.spline.knots[3], len(self.spline.coefficients))

    def covariance(self, u: ArrayLike) -> Array:
        """Returns the covariance (n, 3, 3) mm^2 of the curve's points at parameters u."""
        cell, value = self._basis(np.asarray(u, dtype=float))
        low = np.minimum(np.arange(12)[:, None], np.arange(12))
        high = np.maximum(np.arange(12)[:, None], np.arange(12))
        cells = np.arange(len(self.spline.coefficients) - 3)
        blocks = self.band[3 * cells[:, None, None] + low, high - low].reshape(-1, 4, 3, 4, 3)
        return np.asarray(np.einsum("na,nadbe,nb->nde", value, blocks[cell], value, optimize=True))


def fit_curve(
    cameras: tuple[Camera, Camera],
    annotated: Sequence[Array],
    along: Sequence[Array],
    start_mm: ArrayLike,
    tip_seen: Sequence[bool],
) -> FittedCurve:
    """Fits the most probable curve in space to its annotations in two images.

    Args:
        annotated: per view (n, 2) undistorted px, tip first.
        along: per view (n,) mm, about where on `start_mm` each point lies; beyond its end where one view sees more.
        start_mm: (m, 3) a first curve, tip first, up to where one of the views ends.
        tip_seen: per view, whether the first annotated point is the tip.

    Raises:
        ValueError: the images do not determine a curve.
    """
    start = np.asarray(start_mm, dtype=float)
    length = float(arc_length(start)[-1])
    control = _first_control_points(start, length)
    band = np.zeros((control.size, 12))
    images = (ImageStruct * 2)()
    places = tuple(np.array(value, dtype=float, order="C") for value in along)
    offsets = tuple(np.zeros(len(value)) for value in places)
    held = []  # the structs hold addresses only
    for view, camera in enumerate(cameras):
        P = np.ascontiguousarray(camera.P, dtype=float)
        points = np.ascontiguousarray(annotated[view], dtype=float)
        held.append((P, points))
        fields = (address(P), address(points), address(places[view]), int(tip_seen[view]), address(offsets[view]))
        images[view] = ImageStruct(len(points), *fields)
    spline = SplineStruct(len(control), PITCH_MM, address(control), address(band))
    prior = PriorStruct(
        NOISE_PX, LEAST_NOISE_PX, 1, OUTLIER, BENDING_PER_MM, BEND_PER_MM, CHANGING_PER_MM3, CHANGE_PER_MM2, SPEED,
        ITERATIONS, 0.0,
    )  # fmt: skip
    if library().guide3d_fit(images, ctypes.byref(spline), ctypes.byref(prior)) < 0 or not np.isfinite(control).all():
        raise ValueError(
            f"no curve in space fits the {len(annotated[0])} and {len(annotated[1])} annotated points; "
            "check the order of the cameras and that both annotations start at the tip"
        )
    knots = PITCH_MM * np.arange(-3.0, len(control) + 1)
    end = min(*(float(place[-1]) for place in places), float(knots[-4]))
    curve = BSplineCurve(knots, control)
    noise = float(prior.noise)
    if noise > LEAST_NOISE_PX:
        left = _left_by_weights(OUTLIER)
        noise, band = noise / np.sqrt(left), band / left
    return FittedCurve(curve, end, band, (places[0], places[1]), noise)


def _left_by_weights(outlier: float) -> float:
    """What the weights of outliers leave of the variance of normal noise: E[w z^2] / E[w], w = 1 / (1 + (z / k)^2)."""
    mean = outlier * np.sqrt(np.pi / 2) * float(erfcx(outlier / np.sqrt(2)))
    return outlier**2 * (1 - mean) / mean


def smoothed(points_mm: Array, weights: Array, stiffness: float) -> Array:
    """Smooths (n, 3) points by a penalty on their second differences (Whittaker), with a weight (n,) each."""
    n = len(points_mm)
    band = _difference_band(n, stiffness)
    band[0] += weights
    return np.asarray(solveh_banded(band, points_mm * weights[:, None], lower=True))


def _difference_band(n: int, weight: float) -> Array:
    band = np.zeros((3, n))
    stencil = (1.0, -2.0, 1.0)
    for first in range(3):
        for second in range(first, 3):
            band[second - first, first : n - 2 + first] += weight * stencil[first] * stencil[second]
    return band


def _basis(s: Array, pitch: float, count: int) -> tuple[NDArray[np.int64], Array]:
    cell = np.clip((s / pitch).astype(np.int64), 0, count - 4)
    u = s / pitch - cell
    v = 1.0 - u
    return cell, np.stack([v**3, 3 * u**3 - 6 * u**2 + 4, 3 * v**3 - 6 * v**2 + 4, u**3], axis=1) / 6


def _first_control_points(start: Array, length: float) -> Array:
    """Least squares of the spline through the first curve; beyond its end the spline goes straight on."""
    count = int(np.ceil((length + MARGIN_MM) / PITCH_MM)) + 3
    s = np.linspace(0.0, length, max(50, 4 * count))
    cell, value = _basis(s, PITCH_MM, count)
    points = at_length(start, s)
    band, right = np.zeros((4, count)), np.zeros((count, 3))
    difference = _difference_band(count, 1.0 / PITCH_MM)
    band[:3] += difference
    band[0] += 1e-9
    for first in range(4):
        for second in range(first, 4):
            band[second - first] += np.bincount(cell + first, value[:, first] * value[:, second], count)
        for axis in range(3):
            right[:, axis] += np.bincount(cell + first, value[:, first] * points[:, axis], count)
    return np.ascontiguousarray(solveh_banded(band, right, lower=True))
