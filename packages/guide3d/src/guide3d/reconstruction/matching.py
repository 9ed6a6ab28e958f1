"""Global monotone matching of a wire's two images: which place of one belongs to which place of the other.

Both images, resampled, are signals of one variable, the epipolar angle. Dynamic programming (compiled) finds the pair
of monotone walks along both, tip first, of the least cost: squared epipolar distance, plus a little for every
millimetre in space. A walk starts at both tips, or within reach of them at a price, and ends where one of the images
is used up: a wire that leaves one image first is no error. Loops are none either, for the order along the wire is
kept and not the place.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from guide3d.geometry.bspline import CLOSEST_PX, fit_bspline
from guide3d.geometry.epipolar import EpipolarGeometry, epilines, fundamental_matrix
from guide3d.geometry.polyline import Array, arc_length, checked, resample
from guide3d.native_library import ViewStruct, WeightsStruct, address, library
from guide3d.setting_kinds import PixelDistance, PixelDistanceOrNone, Weight, settings

DENSE_PX = 4.0  # annotations with closer points are curves already and need no spline through them


REACH_PX = 60.0  # how far beyond the last crossing the next one is looked for, beside the step in A
TIP_PX = 0.01
STEP = 4  # samples of A that are skipped between epilines


@settings
class MatchingSettings:
    """How two images are matched.

    match_px: epipolar distance at which it is as dear to match a px as to leave it out
    crossing_px: largest epipolar distance that a match may cross
    noise_px: epipolar distance that is to be expected
    length_per_mm: cost of a mm in space, so that stretches along the epilines do not wander
    uneven_per_px: cost of a px by which one image is walked faster than the other; decides where the epilines do not
    tip_reach_px: how far from both tips a match may begin
    measured_px: epipolar distance up to which a pair counts as measured; the others are completed
    """

    sample_px: PixelDistance = 2.0
    match_px: PixelDistance = 8.0
    crossing_px: PixelDistance = 20.0
    noise_px: PixelDistance = 1.0
    length_per_mm: Weight = 0.1
    uneven_per_px: Weight = 1.5
    tip_reach_px: PixelDistanceOrNone = 60.0
    measured_px: PixelDistance = 3.0


@dataclass(frozen=True, eq=False)
class Match:
    """Which places of two curves belong together, tip first.

    along_a, along_b: (n,) px of arc length from the annotated tips, both ascending
    points_a, points_b: (n, 2) px
    measured: (n,) whether the pair lies on one epipolar plane, or is only completed between its neighbours
    length_a, length_b: px, of the curves in full
    residual_px: epipolar distance, root mean square, with what was left out at the tips counted in: what tells right
        cameras and undistorted annotations from wrong ones
    """

    along_a: Array
    along_b: Array
    points_a: Array
    points_b: Array
    measured: NDArray[np.bool_]
    length_a: float
    length_b: float
    residual_px: float

    @property
    def coverage(self) -> float:
        """Share of the curve that ends first (as a share of its length) in measured pairs."""
        return max(self.covered("a"), self.covered("b"))

    def covered(self, view: str) -> float:
        """Share of the length of view "a" or "b" between measured pairs."""
        along, length = (self.along_a, self.length_a) if view == "a" else (self.along_b, self.length_b)
        both = self.measured[1:] & self.measured[:-1]
        return min(1.0, float(np.diff(along)[both].sum()) / length) if length else 0.0


def image_curve(points: ArrayLike, sample_px: float, what: str = "polyline") -> Array:
    """Returns a curve (m, 2) px through an annotation, resampled at equal arc length.

    Args:
        points: (n, 2) px, tip first; a B-spline by chord length goes through them unless they are dense.

    Raises:
        ValueError: fewer than two different points, or a curve shorter than two samples.
    """
    samples = checked(points, 2, what)
    length = arc_length(samples)[-1]
    if length < 2 * sample_px:
        raise ValueError(f"{what}: expected a curve of at least {2 * sample_px:g} px, got {length:.1f} px")
    if length / (len(samples) - 1) > DENSE_PX:
        curve = fit_bspline(samples, closest=CLOSEST_PX, what=what)
        samples = curve.sample(max(32, int(2 * length / sample_px)))
    return resample(samples, spacing=sample_px)


def match_curves(
    geometry: EpipolarGeometry, curve_a: Array, curve_b: Array, settings: MatchingSettings | None = None
) -> Match:
    """Matches two images of one curve.

    Args:
        curve_a, curve_b: (n, 2) and (m, 2) px in the views every `settings.sample_px`, tip first.

    Returns:
        The match. It may be empty (no pairs) where no stretch of one lies on the epilines of the other.
    """
    chosen = settings or MatchingSettings()
    coordinates = [geometry.coordinate(view, curve) for view, curve in enumerate((curve_a, curve_b))]
    held, views = [], []
    for camera, coordinate in zip(geometry.cameras, coordinates, strict=True):
        values = (coordinate.angle, coordinate.slope_squared, coordinate.rays, camera.centre_mm)
        arrays = [np.ascontiguousarray(value, dtype=float) for value in values]
        held.append(arrays)  # the structs hold addresses only
        views.append(ViewStruct(len(coordinate.angle), *(address(array) for array in arrays)))
    weights = WeightsStruct(
        chosen.sample_px, chosen.match_px, chosen.crossing_px, chosen.noise_px, chosen.length_per_mm,
        chosen.uneven_per_px, chosen.tip_reach_px,
    )  # fmt: skip
    path = np.empty((len(curve_a) + len(curve_b), 2), dtype=np.int32)
    squares = ctypes.c_double()
    count = library().guide3d_match(
        *(ctypes.byref(item) for item in (*views, weights)), ctypes.c_void_p(address(path)), ctypes.byref(squares)
    )
    if count < 0:
        raise MemoryError(f"matching curves of {len(curve_a)} and {len(curve_b)} samples: out of memory")
    path = _without_tail(path[:count])
    i, j = path.T
    a, b = coordinates
    distance = (a.angle[i] - b.angle[j]) / np.sqrt(a.slope_squared[i] + b.slope_squared[j])
    walked = 0.5 * chosen.sample_px * (path[-1] - path[0]).sum() if len(path) else 0.0
    return complete(
        Match(
            along_a=(i * chosen.sample_px).astype(np.float64),
            along_b=(j * chosen.sample_px).astype(np.float64),
            points_a=curve_a[i],
            points_b=curve_b[j],
            measured=np.abs(distance) <= chosen.measured_px,
            length_a=float(arc_length(curve_a)[-1]),
            length_b=float(arc_length(curve_b)[-1]),
            residual_px=float(np.sqrt(squares.value / walked)) if walked else np.inf,
        ),
        curve_a,
        curve_b,
        chosen.sample_px,
    )


def clearly_better(one_px: float, other_px: float) -> bool:
    """Returns whether one epipolar residual is so much smaller than another that chance is out of the question."""
    return one_px < 0.6 * other_px and one_px < other_px - 0.3


def complete(match: Match, curve_a: Array, curve_b: Array, sample_px: float) -> Match:
    """Completes the pairs that are not measured between those that are, by monotone cubic (PCHIP) interpolation.

    Args:
        match: pairs, some of them measured; ends that are not measured stay as they are.
        curve_a, curve_b: (n, 2) and (m, 2) px every `sample_px`.

    Source:
        Fritsch and Carlson, Monotone Piecewise Cubic Interpolation (1980).
    """
    known = np.flatnonzero(match.measured)
    if match.measured.all() or len(known) < 2:
        return match
    inside = slice(known[0], known[-1] + 1)
    both = match.along_a + match.along_b
    if (np.diff(both) <= 0).any():
        return match
    open_ = ~match.measured[inside]
    moved = []
    for along, curve in ((match.along_a, curve_a), (match.along_b, curve_b)):
        new = along.astype(float).copy()
        new[inside][open_] = PchipInterpolator(both[known], along[known])(both[inside][open_])
        index = np.arange(len(curve)) * sample_px
        moved.append((new, np.stack([np.interp(new, index, column) for column in curve.T], axis=-1)))
    (along_a, points_a), (along_b, points_b) = moved
    return replace(match, along_a=along_a, along_b=along_b, points_a=points_a, points_b=points_b)


def _without_tail(path: NDArray[np.int32]) -> NDArray[np.int32]:
    """Drops the last steps along one curve alone: the other has ended there."""
    for view in (0, 1):
        if len(path):
            moving = np.flatnonzero(path[:, view] != path[-1, view])
            path = path[: moving[-1] + 2] if len(moving) else path[:1]
    return path


def match_greedily(geometry: EpipolarGeometry, curve_a: Array, curve_b: Array, sample_px: float) -> Match:
    """Matches two images of one curve by first crossings.

    Args:
        curve_a, curve_b: (n, 2) and (m, 2) px every `sample_px`, tip first.

    Returns:
        The match; `measured` tells crossings from what PCHIP fills in.

    Source:
        Altingövde et al., 3D reconstruction of curvilinear structures (2022), for the monotone completion.
    """
    rows = np.arange(0, len(curve_a), STEP)
    lines = epilines(fundamental_matrix(*geometry.cameras), curve_a[rows])
    crossings = np.full(len(rows), np.nan)
    last, since = 0.0, 0
    for k, line in enumerate(lines):
        first = int(last)
        since += 1  # the further A has gone without a crossing, the further on B may cross next
        until = min(len(curve_b), first + int(REACH_PX / sample_px) + 2 * STEP * since + 1)
        side = curve_b[first:until] @ line[:2] + line[2]
        if k == 0 and abs(side[0]) < TIP_PX:
            crossings[0] = 0.0  # a tip that lies on its epiline, but for rounding
            continue
        changes = np.flatnonzero(side[1:] * side[:-1] <= 0.0)
        for j in changes:
            step = side[j] - side[j + 1]
            place = first + j + (side[j] / step if step else 0.0)
            if place > last or k == 0:
                crossings[k] = last = float(place)
                since = 0
                break
    known = ~np.isnan(crossings)
    known[known] &= np.concatenate([[True], np.diff(crossings[known]) > 1e-6])
    if known.sum() < 2:
        empty = np.zeros((0, 2))
        return Match(*(np.zeros(0),) * 2, empty, empty, np.zeros(0, bool), 0.0, 0.0, np.inf)
    inside = slice(np.flatnonzero(known)[0], np.flatnonzero(known)[-1] + 1)
    filled = PchipInterpolator(rows[known], crossings[known])(rows[inside])
    index = np.arange(len(curve_b))
    points_b = np.stack([np.interp(filled, index, column) for column in curve_b.T], axis=-1)
    points_a = curve_a[rows[inside]]
    distance = geometry.signed_distance(points_a, points_b)
    return Match(
        along_a=np.asarray(rows[inside] * sample_px, dtype=np.float64),
        along_b=filled * sample_px,
        points_a=points_a,
        points_b=points_b,
        measured=known[inside],
        length_a=(len(curve_a) - 1) * sample_px,
        length_b=(len(curve_b) - 1) * sample_px,
        residual_px=float(np.sqrt((distance**2).mean())),
    )
