"""B-spline curves: fitted by chord length to a polyline, evaluated, and in the public data set's layout."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate

from guide3d.geometry.polyline import Array, arc_length, checked, thinned

CLOSEST_PX = 2.0  # points closer than this are one click made twice


@dataclass(frozen=True, eq=False)
class BSplineCurve:
    """A B-spline curve in the plane or in space, tip first.

    Attributes:
        knots: (n + degree + 1,) knots, ascending; parameters run over `domain`.
        coefficients: (n, d) control points.
    """

    knots: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    degree: int = 3

    def __post_init__(self) -> None:
        knots = np.asarray(self.knots, dtype=float)
        coefficients = np.asarray(self.coefficients, dtype=float)
        if coefficients.ndim != 2 or knots.ndim != 1 or len(knots) != len(coefficients) + self.degree + 1:
            raise ValueError(
                f"B-spline of degree {self.degree}: expected (n, d) coefficients and n + {self.degree + 1} knots, "
                f"got {coefficients.shape} and {knots.shape}"
            )
        if not 1 <= self.degree < len(coefficients):
            raise ValueError(f"B-spline: expected a degree of 1 to {len(coefficients) - 1}, got {self.degree}")
        if not (np.isfinite(knots).all() and np.isfinite(coefficients).all()):
            raise ValueError("B-spline: a knot or a coefficient is not finite")
        if (np.diff(knots) < 0).any():
            raise ValueError("B-spline: expected ascending knots")
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def domain(self) -> tuple[float, float]:
        """First and last parameter of the curve."""
        return float(self.knots[self.degree]), float(self.knots[-self.degree - 1])

    @functools.cached_property
    def _spline(self) -> interpolate.BSpline:
        return interpolate.BSpline(self.knots, self.coefficients, self.degree)

    def at(self, u: ArrayLike) -> Array:
        """Returns the (..., d) points at parameters u, which are kept inside the domain."""
        return np.asarray(self._spline(np.clip(u, *self.domain)))

    def sample(self, count: int) -> Array:
        """Returns (count, d) points at equal steps of the parameter, both ends among them."""
        return self.at(np.linspace(*self.domain, count))

    def until(self, end: float) -> BSplineCurve:
        """Returns the same curve up to a parameter of its domain."""
        k, spline = self.degree, self._spline
        for _ in range(k):
            spline = spline.insert_knot(end)
        count = int(np.searchsorted(spline.t, end))
        return BSplineCurve(np.append(spline.t[:count], np.full(k + 1, end)), spline.c[:count], k)

    def to_tck(self, u: ArrayLike | None = None) -> dict[str, Any]:
        """Returns the curve in the public layout: {"tck": {"t", "c", "k"}, "u"}, plain lists, "c" d of n numbers.

        Args:
            u: parameters of the points the curve was fitted to; the curve's own two ends where None.
        """
        parameters = np.asarray(self.domain if u is None else u, dtype=float)
        tck = {"t": self.knots.tolist(), "c": self.coefficients.T.tolist(), "k": int(self.degree)}
        return {"tck": tck, "u": parameters.tolist()}

    @classmethod
    def from_tck(cls, entry: Mapping[str, Any]) -> BSplineCurve:
        """Returns the curve of an entry of the public layout, with or without the outer {"tck", "u"}.

        Raises:
            ValueError: "t", "c" or "k" is missing, or they do not belong together.
        """
        tck = entry.get("tck", entry)
        missing = {"t", "c", "k"} - set(tck)
        if missing:
            raise ValueError(f'B-spline entry: expected "t", "c" and "k", {sorted(missing)} missing')
        knots, degree = np.asarray(tck["t"], dtype=float), int(tck["k"])
        coefficients = np.asarray(tck["c"], dtype=float)
        if coefficients.ndim != 2:
            raise ValueError(f'B-spline entry: expected "c" as [d][n], got shape {coefficients.shape}')
        # splprep pads nothing, but other writers pad coefficients to the number of knots
        return cls(knots, coefficients.T[: len(knots) - degree - 1], degree)


def fit_bspline(
    points: ArrayLike, smoothing: float = 0.0, degree: int = 3, closest: float = CLOSEST_PX, what: str = "polyline"
) -> BSplineCurve:
    """Fits a smoothing B-spline to a polyline, with the chord length as its parameter.

    Args:
        points: (n, d) points, tip first.
        smoothing: sum of squared distances that the fit may leave, in squared units of the points; 0 goes through them.
        degree: degree; lowered where there are fewer than degree + 1 points.
        closest: points closer than this are removed first, in the unit of the points.

    Returns:
        The curve; its parameter runs from 0 to the chord length.

    Raises:
        ValueError: fewer than two different points.

    Source:
        Dierckx, Curve and Surface Fitting with Splines (1993), smoothing with automatic knots.
    """
    if smoothing < 0:
        raise ValueError(f"smoothing: expected 0 or more, got {smoothing}")
    samples = thinned(checked(points, what=what), closest) if closest > 0 else checked(points, what=what)
    samples = checked(samples, what=what)
    u = arc_length(samples)
    k = min(degree, len(samples) - 1)
    (knots, coefficients, k), _ = interpolate.splprep(samples.T, u=u, k=k, s=smoothing)
    return BSplineCurve(np.asarray(knots), np.stack(coefficients, axis=-1), int(k))
