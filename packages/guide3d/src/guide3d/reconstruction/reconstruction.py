"""Reconstruction of a wire in space from its annotations in two images, and how far the result can be trusted."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.camera import Camera
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.polyline import Array, arc_length, checked, distances_to, resample
from guide3d.geometry.triangulation import calibration_covariance, point_covariance, require_millimetres, triangulate
from guide3d.reconstruction.curve_fitting import NOISE_PX, fit_curve, smoothed
from guide3d.reconstruction.matching import (
    Match,
    MatchingSettings,
    clearly_better,
    image_curve,
    match_curves,
    match_greedily,
)

_log = logging.getLogger(__name__)

REJECTION_PX = 25.0  # of a mean reprojection error, as in the thesis
TIPS_PX = 8.0  # epipolar distance of the tips above which something is wrong with cameras or annotation
LEAST_COVERAGE = 0.8  # below this, too
OPEN_SHARE = 0.8  # of the wire along the epilines in both views, above which depth is open
START_STIFFNESS_PX = 20.0  # length over which triangulated pairs are smoothed for a start
NEAR_PX = 4.0  # before the start of the match, annotated points still belong to it
BEYOND_PX = 40.0  # beyond its end
ANNOTATION_PX = 6.0  # closest distance of the annotated points that enter the fit; denser annotations are thinned
SPACING_MM = 0.5  # of the reconstructed points
OUTSIDE_PX = 60.0  # how far an annotated point may lie outside the image: undistorting moves points outwards
MATCHING = MatchingSettings()
PX_MM = 0.2  # about a px's size at the wire, to place points beyond the end of the match


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A wire in space, tip first, up to where it leaves the first of both images.

    curve_mm: (n, 3) every `SPACING_MM` of arc length
    covariance_mm2: (n, 3, 3) of each point: noise of the annotation, prior, and the cameras' own covariances
    spline: the curve, mm
    residual_a_px, residual_b_px: (n,) distance of each point's image from the annotated curve
    coverage: share of the annotation that ends first (as a share of its length) in measured pairs
    coverage_a, coverage_b: share of each annotation in measured pairs
    tangent_share: per view, share of the reconstructed stretch within 10 degrees of the epilines, where depth is open
    noise_px: noise of the annotation as the fit sees it; None of the greedy variant
    accepted: whether both mean reprojection errors stay within the limit
    """

    curve_mm: Array
    covariance_mm2: Array
    spline: BSplineCurve
    match: Match
    residual_a_px: Array
    residual_b_px: Array
    coverage: float
    coverage_a: float
    coverage_b: float
    tangent_share: tuple[float, float]
    noise_px: float | None
    accepted: bool
    warnings: list[str]

    @property
    def sd_mm(self) -> Array:
        """(n,) standard deviation of each point's place: root of the covariance's trace."""
        return np.sqrt(np.trace(self.covariance_mm2, axis1=1, axis2=2))

    @property
    def mean_a_px(self) -> float:
        """Mean reprojection error in view A."""
        return float(self.residual_a_px.mean())

    @property
    def mean_b_px(self) -> float:
        """Mean reprojection error in view B."""
        return float(self.residual_b_px.mean())

    @property
    def length_mm(self) -> float:
        """Length of the curve."""
        return float(arc_length(self.curve_mm)[-1])


def reconstruct(
    camera_a: Camera,
    camera_b: Camera,
    points_a: ArrayLike,
    points_b: ArrayLike,
) -> Reconstruction:
    """Reconstructs a wire: global matching, triangulation, and a smooth curve through both annotations.

    Args:
        points_a, points_b: (n, 2) and (m, 2) undistorted px annotated in A and B, tip first.

    Raises:
        ValueError: an annotation of fewer than two points or outside its image, two that have nothing in common, or
            cameras of another unit than mm.
    """
    require_millimetres(camera_a, camera_b)
    geometry = EpipolarGeometry(camera_a, camera_b)
    annotations, curves = _read_in(geometry, (points_a, points_b))
    match = match_curves(geometry, curves[0], curves[1])
    _check_common(match)
    start, steps = _first_curve(geometry, match, MATCHING.sample_px)
    pairs = [_fit_input(match, annotation, view, steps, start) for view, annotation in enumerate(annotations)]
    used, places = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    tips = (bool(match.along_a[0] <= 0.0), bool(match.along_b[0] <= 0.0))
    if min(len(points) for points in used) < 2:
        raise ValueError("the annotations have less than two points each in common; check that both start at the tip")
    fitted = fit_curve(geometry.cameras, used, places, start, tips)
    curve, covariance = fitted.sample(SPACING_MM)
    covariance = covariance + calibration_covariance(camera_a, camera_b, curve)
    spline = fitted.spline.until(fitted.end)
    return _result(geometry, curve, covariance, spline, match, curves, fitted.noise_px)


def reconstruct_greedy(
    camera_a: Camera,
    camera_b: Camera,
    points_a: ArrayLike,
    points_b: ArrayLike,
) -> Reconstruction:
    """Reconstructs a wire in the thesis's way: first crossings, PCHIP between, linear triangulation, a spline.

    Takes and raises what `reconstruct` does.
    """
    geometry = EpipolarGeometry(camera_a, camera_b)
    _, curves = _read_in(geometry, (points_a, points_b))
    match = match_greedily(geometry, curves[0], curves[1], MATCHING.sample_px)
    _check_common(match)
    points = triangulate(camera_a, camera_b, match.points_a, match.points_b, iterations=0)
    spline = fit_bspline(points, smoothing=0.01 * len(points), closest=SPACING_MM, what="triangulated curve")
    curve = resample(spline.sample(8 * len(points)), spacing=SPACING_MM)
    covariance = point_covariance(camera_a, camera_b, curve, NOISE_PX)
    covariance = covariance + calibration_covariance(camera_a, camera_b, curve)
    return _result(geometry, curve, covariance, spline, match, curves, None)


def _read_in(geometry: EpipolarGeometry, points: tuple[ArrayLike, ArrayLike]) -> tuple[list[Array], list[Array]]:
    annotations, curves = [], []
    for camera, annotation, letter in zip(geometry.cameras, points, "AB", strict=True):
        what = f"annotation of camera {letter}"
        polyline = checked(annotation, 2, what)
        outside = ~camera.contains(polyline, OUTSIDE_PX)
        if outside.any():
            first = int(np.flatnonzero(outside)[0])
            raise ValueError(
                f"{what}: point {first} at ({polyline[first, 0]:.1f}, {polyline[first, 1]:.1f}) px lies outside the "
                f"image of {camera.width} x {camera.height}; check the image's size and the order of x and y"
            )
        curve = image_curve(polyline, MATCHING.sample_px, what)
        if np.median(np.linalg.norm(np.diff(polyline, axis=0), axis=1)) < ANNOTATION_PX:
            polyline = resample(polyline, count=max(8, int(arc_length(polyline)[-1] / ANNOTATION_PX)))
        annotations.append(polyline)
        curves.append(curve)
    return annotations, curves


def _check_common(match: Match) -> None:
    if len(match.along_a) < 4 or min(np.ptp(match.along_a), np.ptp(match.along_b)) <= 0:
        raise ValueError(
            "the two annotations have no stretch in common: no point of one lies near an epiline of the other; "
            "check that the cameras belong to the images and are not swapped"
        )


def _first_curve(geometry: EpipolarGeometry, match: Match, sample_px: float) -> tuple[Array, Array]:
    """Smoothed triangulated pairs (m, 3) mm at equal steps of the mean of both arc lengths, and those means (m,) px."""
    pairs = triangulate(*geometry.cameras, match.points_a, match.points_b, iterations=0)
    mean = 0.5 * (match.along_a + match.along_b)
    steps = np.arange(mean[0], mean[-1] + 0.1, sample_px)
    points = np.stack([np.interp(steps, mean, column) for column in pairs.T], axis=-1)
    weights = np.ones(len(steps))
    weights[[0, -1]] = 100.0  # the ends hold the curve's length
    return smoothed(points, weights, (START_STIFFNESS_PX / sample_px) ** 4), steps


def _fit_input(match: Match, annotation: Array, view: int, steps: Array, start: Array) -> tuple[Array, Array]:
    """The annotated points of a view that enter the fit, and where on the first curve they lie, mm."""
    along, length = ((match.along_a, match.length_a), (match.along_b, match.length_b))[view]
    position = arc_length(annotation)
    position *= length / position[-1]  # the curve through the points is longer than their polygon
    # a little more than matched: where the other view has ended, this one still shapes the curve
    keep = (position >= along[0] - NEAR_PX) & (position <= along[-1] + BEYOND_PX)
    position = position[keep]
    # along one image alone the other stands still; a hair of slope keeps the interpolation defined
    mean = np.interp(position, along + 1e-6 * np.arange(len(along)), 0.5 * (match.along_a + match.along_b))
    place = np.interp(mean, steps, arc_length(start))
    return annotation[keep], place + PX_MM * np.maximum(position - along[-1], 0.0)


def _result(
    geometry: EpipolarGeometry,
    curve: Array,
    covariance: Array,
    spline: BSplineCurve,
    match: Match,
    curves: list[Array],
    noise_px: float | None,
) -> Reconstruction:
    residuals, shares = [], []
    for view, (camera, annotation) in enumerate(zip(geometry.cameras, curves, strict=True)):
        image = camera.project(curve)
        residuals.append(distances_to(annotation, image))
        shares.append(geometry.tangent_share(view, image))
    means = [float(residual.mean()) for residual in residuals]
    accepted = max(means) <= REJECTION_PX
    warnings = _warnings(geometry, match, curves, means)
    if min(shares) > OPEN_SHARE:
        warnings.append(
            f"depth is hardly seen: {min(shares):.0%} of the wire runs along the epilines in both views; "
            "its shape towards the cameras is a guess, and less certain than its standard deviation says"
        )
    for warning in warnings:
        _log.info(warning)
    return Reconstruction(
        curve_mm=curve,
        covariance_mm2=covariance,
        spline=spline,
        match=match,
        residual_a_px=residuals[0],
        residual_b_px=residuals[1],
        coverage=match.coverage,
        coverage_a=match.covered("a"),
        coverage_b=match.covered("b"),
        tangent_share=(shares[0], shares[1]),
        noise_px=noise_px,
        accepted=accepted,
        warnings=warnings,
    )


def _warnings(geometry: EpipolarGeometry, match: Match, curves: list[Array], means: list[float]) -> list[str]:
    warnings = []
    if max(means) > REJECTION_PX:
        warnings.append(
            f"rejected: mean reprojection error {means[0]:.1f} / {means[1]:.1f} px, the limit is {REJECTION_PX:g} px"
        )
    tips = float(geometry.signed_distance(curves[0][:1], curves[1][:1])[0])
    if abs(tips) <= TIPS_PX and match.coverage >= LEAST_COVERAGE:
        return warnings
    # what the greedy matching misses says nothing about the annotation and the cameras
    judged = match_curves(geometry, curves[0], curves[1])
    if abs(tips) > TIPS_PX or judged.coverage < LEAST_COVERAGE:
        warnings.append(
            f"the tips miss each other's epilines by {abs(tips):.1f} px, {judged.coverage:.0%} of the wire is "
            "measured; the annotation may be distorted, or an annotated tip is not the tip"
        )
        swapped = EpipolarGeometry(geometry.cameras[1], geometry.cameras[0])
        other = match_curves(swapped, curves[0], curves[1])
        if clearly_better(other.residual_px, judged.residual_px):
            warnings.append(
                f"the cameras look swapped: the epipolar residual is {judged.residual_px:.1f} px as given and "
                f"{other.residual_px:.1f} px with A and B exchanged"
            )
    return warnings
