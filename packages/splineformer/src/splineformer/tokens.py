"""Spline tokens: a curve in an image as a short sequence of (knot, x, y), and back.

A clamped cubic B-spline of n control points has n + 4 knots, the first four of them zero. Without those there is one
knot a control point, and the pairs are the tokens: (t[i + 4], x[i], y[i]). The first token's point is the tip, the last
four knots are the length of the curve. Nothing is lost: `curve_of_tokens` puts the four zeros back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import interpolate
from scipy.spatial import cKDTree

from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.polyline import Array, arc_length, checked, resample, thinned
from splineformer.image_input import pixels_of_shares

DEGREE = 3
FEWEST_TOKENS = DEGREE + 1
_FEWEST_POINTS = 8  # a stub is sampled again until a cubic can be fitted to it
_COARSER = 2.0  # of the smoothing, until the tokens are few enough
_LEAST_SQUARES_A_KNOT = 12  # points
_LENGTH_SAMPLES = 400  # of a curve whose length is measured
_SAMPLES_A_TOKEN = 40  # of a curve whose distance from a polyline is measured
_LIMIT = 23  # tokens
_TOLERANCE_PX = 0.25  # root mean square distance that the smoothing spline may leave; more only to keep the limit
_CLOSEST_PX = 2.0  # points closer than this are one click made twice, and removed first


def tokens_of_polyline(points_px: ArrayLike) -> Array:
    """Fits a smoothing cubic to a polyline by chord length and returns its tokens.

    Args:
        points_px: (n, 2) px, tip first; they may cross themselves, lie outside the image, or be a short stub.

    Returns:
        (m, 3) tokens: knot (px along the curve, from the tip), x, y (px).

    Raises:
        ValueError: fewer than two different points, or points that are not finite.

    Source:
        Dierckx, Curve and Surface Fitting with Splines (1993), smoothing with automatic knots.
    """
    points = checked(points_px, 2, "curve")
    if arc_length(points)[-1] > _FEWEST_POINTS * _CLOSEST_PX:
        points = thinned(points, _CLOSEST_PX)
    if len(points) < _FEWEST_POINTS:
        points = _subdivided(points)
    u = arc_length(points)
    smoothing = len(points) * _TOLERANCE_PX**2
    while True:
        (knots, coefficients, _), _ = interpolate.splprep(points.T, u=u, k=DEGREE, s=smoothing, quiet=True)
        tokens = tokens_of_curve(BSplineCurve(np.asarray(knots), np.stack(coefficients, axis=-1), DEGREE))
        if len(tokens) <= _LIMIT:
            return tokens
        smoothing = max(smoothing * _COARSER, 1e-3)


def _subdivided(points: Array) -> Array:
    """The same polyline with points halved in between until there are enough; corners stay where they are."""
    while len(points) < _FEWEST_POINTS:
        between = (points[1:] + points[:-1]) / 2
        points = np.insert(points, np.arange(1, len(points)), between, axis=0)
    return points


def tokens_of_curve(curve: BSplineCurve) -> Array:
    """Returns the (n, 3) tokens of a clamped cubic B-spline in the plane, without loss.

    Raises:
        ValueError: another degree or dimension, or knots that do not begin with four zeros.
    """
    n, dimension = curve.coefficients.shape
    if curve.degree != DEGREE or dimension != 2:
        raise ValueError(f"tokens: expected a cubic in the plane, got degree {curve.degree} in {dimension} dimensions")
    if curve.knots[:FEWEST_TOKENS].any() or n < FEWEST_TOKENS:
        raise ValueError(f"tokens: expected knots that begin with four zeros, got {curve.knots[:FEWEST_TOKENS]}")
    return np.column_stack([curve.knots[FEWEST_TOKENS:], curve.coefficients])


def tokens_on_knots(points_px: ArrayLike, knots: Array) -> Array:
    """Fits (m, 3) tokens on given knots to a polyline by least squares, the share of its length being the parameter.

    Args:
        points_px: (n, 2) px, tip first.
        knots: (m + 4,) clamped, from 0 to 1.

    Raises:
        ValueError: fewer than two different points.
    """
    points = resample(checked(points_px, 2, "curve"), count=_LEAST_SQUARES_A_KNOT * len(knots))
    u = np.linspace(0.0, 1.0, len(points))
    spline = interpolate.make_lsq_spline(u, points, np.asarray(knots, dtype=float), DEGREE)
    length = float(arc_length(points)[-1])
    return np.column_stack([knots[FEWEST_TOKENS:] * length, spline.c])


def curve_of_tokens(tokens: ArrayLike) -> BSplineCurve:
    """Returns the B-spline of tokens, clamped at both ends; knots that a network put out of order are put in order.

    Args:
        tokens: (n, 3) knot, x, y; at least four.

    Raises:
        ValueError: too few tokens, not finite, or all knots zero.
    """
    array = np.asarray(tokens, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < FEWEST_TOKENS:
        raise ValueError(f"tokens: expected (n, 3) with n of at least {FEWEST_TOKENS}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("tokens: expected finite numbers")
    knots = np.maximum.accumulate(np.maximum(array[:, 0], 0.0))
    if knots[-1] <= 0:
        raise ValueError("tokens: expected a last knot above 0, the length of the curve")
    knots[-FEWEST_TOKENS:] = knots[-1]
    return BSplineCurve(np.concatenate([np.zeros(FEWEST_TOKENS), knots]), array[:, 1:], DEGREE)


def sampled(tokens: ArrayLike, count: int = 200) -> Array:
    """Returns (count, 2) points of the tokens' curve at equal arc length, both ends among them."""
    curve = curve_of_tokens(tokens)
    dense = curve.sample(max(4 * count, _SAMPLES_A_TOKEN * len(curve.coefficients)))
    moved = np.linalg.norm(np.diff(dense, axis=0), axis=1) > 0
    if not moved.any():
        return np.repeat(dense[:1], count, axis=0)
    return resample(dense[np.concatenate([[True], moved])], count=count)


def round_trip_px(points_px: ArrayLike, tokens: ArrayLike) -> float:
    """Returns the mean distance (px) of a polyline's points, a pixel apart, from the curve of its tokens."""
    points = checked(points_px, 2, "curve")
    count = max(int(arc_length(points)[-1]), 2)
    curve = curve_of_tokens(tokens)
    dense = curve.sample(max(8 * count, _SAMPLES_A_TOKEN * len(curve.coefficients)))
    return float(cKDTree(dense).query(resample(points, count=count))[0].mean())


def tokens_px(tokens: Array, side_px: float) -> Array:
    """Tokens in shares of the side, knots of any scale, to tokens in pixels with knots along the curve."""
    knots = np.maximum.accumulate(np.maximum(tokens[:, 0], 0.0))
    points = pixels_of_shares(tokens[:, 1:], (side_px, side_px))
    if knots[-1] <= 0:
        knots = np.concatenate([np.linspace(0, 1, len(knots) - FEWEST_TOKENS + 2)[1:], np.ones(FEWEST_TOKENS - 1)])
    curve = curve_of_tokens(np.column_stack([knots, points]))
    length = max(float(arc_length(curve.sample(_LENGTH_SAMPLES))[-1]), 1e-6)
    return np.column_stack([curve.knots[FEWEST_TOKENS:] * (length / curve.knots[-1]), points])
