"""Whether annotations and cameras belong together, by epipolar residuals: swapped cameras, raw or undistorted points.

The residual of a pair is the epipolar distance, root mean square, of its best monotone match. One pair may deceive:
over a whole set the right assignment is the one with the least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from guide3d.geometry.camera import Camera
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.polyline import Array
from guide3d.reconstruction.matching import MatchingSettings, clearly_better, image_curve, match_curves

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset

Pair = tuple[ArrayLike, ArrayLike]
_PAIRS = 60  # of a data set, whose epipolar residuals are asked


@dataclass(frozen=True)
class Verdict:
    """Which of two readings of the data fits the geometry.

    residual_px, other_px: median epipolar residuals, of the answer and of the other reading
    sure: whether the difference is beyond chance
    """

    answer: str
    residual_px: float
    other_px: float
    sure: bool
    sentence: str


def epipolar_residuals(camera_a: Camera, camera_b: Camera, pairs: Sequence[Pair]) -> Array:
    """Returns the epipolar residual (n,) px of each pair of annotations, (k, 2) px in A and (l, 2) px in B.

    Raises:
        ValueError: no pairs, or an annotation that is no curve.
    """
    if not len(pairs):
        raise ValueError("expected at least one pair of annotations, got none")
    chosen = MatchingSettings()
    geometry = EpipolarGeometry(camera_a, camera_b)
    residuals = []
    for a, b in pairs:
        curves = (
            image_curve(a, chosen.sample_px, "annotation of camera A"),
            image_curve(b, chosen.sample_px, "annotation of camera B"),
        )
        # what leaves the tips out has no residual of its own, and is as bad as what is matched at the limit
        residuals.append(min(match_curves(geometry, *curves).residual_px, 2 * chosen.crossing_px))
    return np.array(residuals)


def swapped_cameras(camera_a: Camera, camera_b: Camera, pairs: Sequence[Pair]) -> Verdict:
    """Tells whether the cameras belong to each other's images: "as given" or "swapped".

    Args:
        camera_a, camera_b: thought to have taken the first and the second of each pair.
        pairs: annotations ((n, 2), (m, 2)) px, tip first.
    """
    baseline = float(np.median(epipolar_residuals(camera_a, camera_b, pairs)))
    other = float(np.median(epipolar_residuals(camera_b, camera_a, pairs)))
    return _verdict(("as given", "swapped"), baseline, other, "the cameras are", len(pairs))


def undistorted_or_raw(
    camera_a: Camera,
    camera_b: Camera,
    pairs: Sequence[Pair],
    undistort_a: Callable[[Array], Array],
    undistort_b: Callable[[Array], Array],
) -> Verdict:
    """Tells whether annotations are "undistorted" already, or "raw" pixels of the image intensifier.

    Args:
        pairs: annotations ((n, 2), (m, 2)) px, tip first.
        undistort_a, undistort_b: take raw px (n, 2) of A and B to undistorted ones.
    """
    moved = [(undistort_a(np.asarray(a, dtype=float)), undistort_b(np.asarray(b, dtype=float))) for a, b in pairs]
    baseline = float(np.median(epipolar_residuals(camera_a, camera_b, pairs)))
    other = float(np.median(epipolar_residuals(camera_a, camera_b, moved)))
    return _verdict(("undistorted", "raw"), baseline, other, "the annotations are", len(pairs))


def _verdict(answers: tuple[str, str], baseline: float, other: float, subject: str, count: int) -> Verdict:
    better = other < baseline
    answer = answers[1] if better else answers[0]
    residual, worse = (other, baseline) if better else (baseline, other)
    sure = clearly_better(residual, worse)
    tone = "" if sure else ", probably"
    sentence = (
        f"{subject} {answer}{tone}: epipolar residual {residual:.2f} px, against {worse:.2f} px were they "
        f"{answers[0 if better else 1]} (median of {count} pairs)"
    )
    return Verdict(answer, residual, worse, sure, sentence)


def swapped_in(data: Dataset, undistorted: bool | None) -> Verdict | None:
    """As `swapped_cameras` of a data set; None without cameras. `undistorted` None counts as yes."""
    if data.camera_a is None or data.camera_b is None:
        return None
    pairs = _pairs(data)
    if undistorted is False and data.distortions is not None:
        a, b = data.distortions
        pairs = [(a.undistort_points(one), b.undistort_points(other)) for one, other in pairs]
    return swapped_cameras(data.camera_a, data.camera_b, pairs)


def undistorted_or_raw_in(data: Dataset) -> Verdict | None:
    """As `undistorted_or_raw` of a data set; None without cameras and maps of their distortion."""
    if data.camera_a is None or data.camera_b is None or data.distortions is None:
        return None
    a, b = data.distortions
    return undistorted_or_raw(data.camera_a, data.camera_b, _pairs(data), a.undistort_points, b.undistort_points)


def _pairs(data: Dataset) -> list[tuple[np.ndarray, np.ndarray]]:
    chosen = np.unique(np.linspace(0, len(data) - 1, _PAIRS).astype(int))
    return [(data.frames[i].polyline("a"), data.frames[i].polyline("b")) for i in chosen]
