"""Reads two X-ray images of one moment to a wire in space: candidates of both views are tried against each other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import Distortion
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.polyline import Array, arc_length
from guide3d.geometry.triangulation import projection_jacobian
from guide3d.reading.curve_reading import ImageCurve, Prior
from guide3d.reading.image_reading import ImageReading, MapReader, read
from guide3d.reading.path_search import GUESSED
from guide3d.reconstruction.matching import MatchingSettings, clearly_better, image_curve, match_curves
from guide3d.reconstruction.reconstruction import Reconstruction, reconstruct

VIEWS = ("A", "B")
FRAMES = ("auto", "raw", "undistorted")

_Move = Callable[[Array], Array]


Image = NDArray[np.generic]


# How two views are brought together.
_RESIDUAL_PER_PX = 25.0  # what a px of epipolar residual costs a pair of candidates, in px of certain wire
_COVERAGE = 300.0  # what it costs to match nothing of a curve, in px as well
_SAMPLE_PX = 4.0  # spacing of the points that are matched
# epipolar residual above which other readings are tried: images already undistorted, cameras swapped
_DOUBTFUL_PX = 3.0
_COMMON_PX = 0.3  # standard deviation of an image's curve that the fit does not see, for it is common to many points
_TIP_PX = 2.0  # standard deviation of a tip along its curve
_TIP_MM = 3.0  # how far from the tip that counts
_REFUSED_PX = 8.0  # epipolar residual above which the two curves are not of one wire under these cameras
_LEAST_COVERAGE = 0.5  # share of the wire below which they are not, either


@dataclass(frozen=True, eq=False)
class PairReading:
    """A wire in space, read from two images.

    curve_mm: (n, 3) tip first, every 0.5 mm
    covariance_mm2: (n, 3, 3) of each point: pixels of both views, gaps in them, the wire's stiffness, the cameras
    views: what each image shows, with the candidate that was chosen; px of the images as given
    reconstruction: with residuals and matched points
    residual_px: epipolar residual of the two curves
    refusal: why the two curves are not of one wire under these cameras, as a sentence; empty where they are
    messages: what to be careful about, as sentences
    """

    curve_mm: Array
    covariance_mm2: Array
    views: tuple[ImageReading, ImageReading]
    reconstruction: Reconstruction
    residual_px: float
    refusal: str
    messages: list[str]

    @property
    def accepted(self) -> bool:
        """Whether the two curves are of one wire under these cameras."""
        return not self.refusal

    @property
    def sd_mm(self) -> Array:
        """(n,) standard deviation of each point's place: root of the covariance's trace."""
        return np.sqrt(np.trace(self.covariance_mm2, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False)
class _Choice:
    """A pair of candidates; larger values are better."""

    value: float
    numbers: tuple[int, int]
    residual_px: float
    coverage: float


def read_pair(
    image_a: ArrayLike,
    image_b: ArrayLike,
    cameras: Sequence[Camera],
    distortions: Sequence[Distortion] | None = None,
    frame: str = "auto",
    reader: MapReader | None = None,
    priors: Sequence[Prior | None] = (None, None),
) -> PairReading:
    """Reads a wire in space from two X-ray images of one moment.

    Args:
        image_a, image_b: (h, w) grey values of the views of `cameras`, in this order; see `guide3d.read`.
        cameras: A and B, of undistorted pixels.
        distortions: of both detectors, where the images are raw; None: they have none, or were undistorted.
        frame: "raw": the images are as recorded, the distortions apply. "undistorted": they do not. "auto": they do if
            there are any, unless the epipolar residual shows clearly that the images were undistorted before.
        reader: makes the probability maps; None: the one that is shipped.
        priors: of both images, the wire a moment before, px.

    Raises:
        ValueError: an image that cannot be read or shows no wire, of another size than its camera's, one image twice,
            or two curves that have nothing in common.
    """
    if len(cameras) != 2 or (distortions is not None and len(distortions) != 2):
        raise ValueError("expected two cameras, and two distortions or none")
    if frame not in FRAMES:
        raise ValueError(f"expected a frame among {', '.join(FRAMES)}, got {frame!r}")
    if frame == "raw" and distortions is None:
        raise ValueError("raw images need the distortions of both detectors, or cameras that were calibrated raw")
    check_different(image_a, image_b)
    views = []
    for name, image, camera, prior in zip(VIEWS, (image_a, image_b), cameras, priors, strict=True):
        views.append(_view(name, np.asarray(image), camera, reader, prior))
    return combine(views, cameras, distortions, frame)


def check_different(image_a: ArrayLike, image_b: ArrayLike) -> None:
    """Refuses one image as both views.

    Raises:
        ValueError: both have the same pixels.
    """
    if np.array_equal(np.asarray(image_a), np.asarray(image_b)):
        raise ValueError("images A and B are one image: two views need two different images")


def combine(
    views: Sequence[ImageReading],
    cameras: Sequence[Camera],
    distortions: Sequence[Distortion] | None = None,
    frame: str = "auto",
) -> PairReading:
    """Combines two readings of images to a wire in space; as `read_pair`, which reads the images first."""
    messages: list[str] = []
    geometry = EpipolarGeometry(cameras[0], cameras[1])
    moves: list[_Move] = [_same, _same]
    if distortions is not None and frame != "undistorted":
        moves = [distortion.undistort_points for distortion in distortions]
    curves = [[move(curve.points_px) for curve in view.candidates] for view, move in zip(views, moves, strict=True)]
    best = _best(geometry, views, curves)
    if best.residual_px > 0.5 * _DOUBTFUL_PX and distortions is not None and frame == "auto":
        plain = [[curve.points_px for curve in view.candidates] for view in views]
        other = _best(geometry, views, plain)
        if clearly_better(other.residual_px, best.residual_px):
            messages.append(
                f"the images look undistorted already: epipolar residual {other.residual_px:.1f} px, against "
                f"{best.residual_px:.1f} px after the distortion maps, which were left out"
            )
            best, curves, moves = other, plain, [_same, _same]
    accepted = best.residual_px <= _REFUSED_PX and best.coverage >= _LEAST_COVERAGE
    doubt = _doubt(best, accepted, views, cameras, distortions if moves[0] is not _same else None)
    messages += [doubt] if doubt else []
    a, b = best.numbers
    points = (curves[0][a], curves[1][b])
    wire = reconstruct(cameras[0], cameras[1], *points)
    read_as = (views[0].with_candidate(a), views[1].with_candidate(b))
    of_views = [f"image {name}: {text}" for name, view in zip(VIEWS, read_as, strict=True) for text in view.messages]
    messages = of_views + messages
    unseen = [
        f"{view.guessed:.0%} of the curve in image {name} is guessed, more than {GUESSED:.0%}: "
        "a curve in space needs a wire that both images show"
        for name, view in zip(VIEWS, read_as, strict=True)
        if view.guessed > GUESSED
    ]
    covariance = wire.covariance_mm2 + _reading_covariance(cameras, wire, points, read_as)
    refusal = doubt
    if accepted:  # otherwise the reconstruction's warnings say the same once more
        messages += wire.warnings
        refusal = "" if wire.accepted else "; ".join(wire.warnings)
    messages += unseen
    refusal = "; ".join([*([refusal] if refusal else []), *unseen])
    return PairReading(wire.curve_mm, covariance, read_as, wire, best.residual_px, refusal, messages)


def _view(
    name: str,
    image: np.ndarray,
    camera: Camera,
    reader: MapReader | None,
    prior: Prior | None,
) -> ImageReading:
    if image.shape[:2] != (camera.height, camera.width):
        size = " x ".join(str(side) for side in image.shape[1::-1])
        raise ValueError(
            f"image {name} has {size} px, its camera {camera.name or name} {camera.width} x {camera.height}: "
            "expected the size that the camera was calibrated for"
        )
    try:
        view = read(image, reader, prior)
    except ValueError as error:
        raise ValueError(f"image {name}: {error}") from None
    if not view.found:
        raise ValueError(f"image {name}: {'; '.join(view.messages)}")
    return view


def _same(points: Array) -> Array:
    return points


def _best(
    geometry: EpipolarGeometry,
    views: Sequence[ImageReading],
    curves: Sequence[Sequence[Array]],
) -> _Choice:
    """The pair of candidates that fits both images and the epipolar geometry best."""
    sampled = [
        [image_curve(points, _SAMPLE_PX, f"curve of image {name}") for points in of_view]
        for name, of_view in zip(VIEWS, curves, strict=True)
    ]
    matching = MatchingSettings(sample_px=_SAMPLE_PX)
    best: _Choice | None = None
    for i, curve_a in enumerate(sampled[0]):
        for j, curve_b in enumerate(sampled[1]):
            match = match_curves(geometry, curve_a, curve_b, matching)
            residual = match.residual_px if len(match.along_a) else np.inf
            score = _lost(views[0].candidates, i) + _lost(views[1].candidates, j)
            value = -score - _COVERAGE * (1.0 - match.coverage)
            value -= _RESIDUAL_PER_PX * min(residual, 2.0 * _REFUSED_PX)
            if best is None or value > best.value:
                best = _Choice(value, (i, j), float(residual), match.coverage)
    assert best is not None
    return best


def _lost(candidates: Sequence[ImageCurve], number: int) -> float:
    return candidates[0].score - candidates[number].score


def _doubt(
    best: _Choice,
    accepted: bool,
    views: Sequence[ImageReading],
    cameras: Sequence[Camera],
    distortions: Sequence[Distortion] | None,
) -> str:
    """A sentence on two curves that do not fit well: cameras swapped, another camera, or a wrong curve; else empty."""
    moves: list[_Move] = [_same, _same]
    if distortions is not None:
        moves = [distortions[1].undistort_points, distortions[0].undistort_points]
    whole = best.residual_px > _DOUBTFUL_PX or not accepted
    options = [view.candidates if whole else [view.candidates[k]] for view, k in zip(views, best.numbers, strict=True)]
    curves = [[move(curve.points_px) for curve in of_view] for of_view, move in zip(options, moves, strict=True)]
    swapped = _best(EpipolarGeometry(cameras[1], cameras[0]), views, curves)
    evidence = f"epipolar residual {best.residual_px:.1f} px, {best.coverage:.0%} of the wire matched"
    if clearly_better(swapped.residual_px, best.residual_px) and swapped.coverage >= best.coverage - 0.05:
        return f"the cameras look swapped: {evidence}, against {swapped.residual_px:.1f} px with A and B exchanged"
    if not whole:
        return ""
    if accepted:
        return f"the two curves fit each other poorly: {evidence}; the depth is less certain than its deviation says"
    return f"the two curves do not show one wire under these cameras: {evidence}; is each camera that of its image?"


def _reading_covariance(
    cameras: Sequence[Camera],
    wire: Reconstruction,
    points: tuple[Array, Array],
    views: Sequence[ImageReading],
) -> Array:
    """What the reading of images adds to the covariance (n, 3, 3) mm^2 of a fit that takes points as independent.

    Errors of a curve's neighbouring points are alike, gaps deviate by more than the fit's noise, and the end of a tip
    is uncertain along the wire.
    """
    variances, jacobians = [], []
    for camera, curve, view in zip(cameras, points, views, strict=True):
        nearest = cKDTree(curve).query(camera.project(wire.curve_mm))[1]
        gap = np.maximum(view.sd_px[nearest] ** 2 - view.sd_px.min() ** 2, 0.0)
        variances += [gap + _COMMON_PX**2] * 2
        jacobians.append(projection_jacobian(camera, wire.curve_mm))
    back = np.linalg.pinv(np.concatenate(jacobians, axis=1))
    across = np.einsum("nij,jn,nkj->nik", back, np.array(variances), back)
    tangent = np.gradient(wire.curve_mm, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    # px of both images along the wire, and with them the tip's deviation, in mm; the sharper view counts
    along = max(float(np.linalg.norm(jacobian[0] @ tangent[0])) for jacobian in jacobians)
    tip_mm = _TIP_PX / max(along, 1e-6)
    share = np.exp(-0.5 * (arc_length(wire.curve_mm) / _TIP_MM) ** 2)
    return np.asarray(across + (share * tip_mm**2)[:, None, None] * tangent[:, :, None] * tangent[:, None, :])


@dataclass(frozen=True, eq=False)
class FrameReading:
    """A frame of a sequence: its reading, or why there is none."""

    reading: ImageReading | PairReading | None
    said: str = ""


def read_sequence(images: Iterable[Image], reader: MapReader | None = None) -> Iterator[FrameReading]:
    """Reads the images of one view, in order; a frame that cannot be read leaves the others alone."""
    prior: Prior | None = None
    for image in images:
        try:
            reading = read(image, reader, prior)
        except ValueError as error:
            yield FrameReading(None, str(error))
            continue
        if reading.found:
            prior = Prior(reading.points_px)
        yield FrameReading(reading)


def read_pairs(
    images_a: Iterable[Image],
    images_b: Iterable[Image],
    cameras: Sequence[Camera],
    distortions: Sequence[Distortion] | None = None,
    frame: str = "auto",
    reader: MapReader | None = None,
) -> Iterator[FrameReading]:
    """Reads pairs of images, in order, as `read_pair`; a frame without its partner is given, but not read."""
    priors: list[Prior | None] = [None, None]
    for a, b in zip_longest(images_a, images_b):
        if a is None or b is None:
            yield FrameReading(None, f"there is no image of camera {'A' if a is None else 'B'} at this moment")
            continue
        try:
            reading = read_pair(a, b, cameras, distortions, frame, reader, priors)
        except ValueError as error:
            yield FrameReading(None, str(error))
            continue
        if reading.accepted:
            priors = [Prior(view.points_px) for view in reading.views]
        yield FrameReading(reading)
