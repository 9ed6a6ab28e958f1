"""Evaluation of trained networks on the images of acquisitions they have not seen: shapes in space, and masks.

Both evaluations give figures as plain numbers and lists, so that they can be written as JSON (a metric is its mean and
its standard deviation), and examples as arrays: one at each of some quantiles of the first metric.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from guide3d.dataset.dataset import VIEWS, Dataset, images_of
from guide3d.geometry.camera import Camera
from guide3d.geometry.metrics import curve_metrics, distances_along
from guide3d.geometry.polyline import Array, arc_length, resample
from guide3d.learning.picture_store import PictureStore, averaged
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor
from guide3d.learning.shape_samples import CAMERA, clips_of, curve_of
from guide3d.reconstruction.evaluation import METRICS as SHAPE_METRICS
from guide3d.reconstruction.evaluation import mean_and_spread

SEGMENTATION_METRICS = ("dice", "iou_foreground", "miou", "jaccard", "centreline_dice")
SPACING_MM = 5.0  # of the error along the wire
_FEWEST = 5  # wires over which the error at a place is averaged
_SHAPE_QUANTILES, _MASK_QUANTILES = (0.1, 0.5, 0.9), (0.05, 0.5, 0.95)  # of MaxED and Dice, shown as examples
_TIMED = 20  # frames that the speed is measured with
_HALF = 128  # grey level from which an averaged mask counts as wire

Evaluation = tuple[dict[str, Any], dict[str, Any]]  # figures and arrays


def evaluate_shape(
    predictor: ShapePredictor | FGRNPredictor, data: Dataset, acquisitions: Sequence[str], pictures: Path | None = None
) -> Evaluation:
    """Compares predicted curves with the true ones, frame by frame.

    3D-FGRN has no stop: its points count as far as the true wire goes.

    Args:
        pictures: folder that keeps prepared pictures; None: in memory.

    Returns:
        Figures: the distances in mm, "length_error_mm", "reprojection_px" (None without a camera), "along_mm" and
        "along_error_mm", "frames", "ms_a_frame" of processor time and "skipped" images. Arrays: "frames" (3,) and
        "predicted<k>" and "true<k>" (n, 3) mm.
    """
    true = {index: curve for index, frame in enumerate(data.frames) if (curve := curve_of(frame)) is not None}
    fgrn = isinstance(predictor, FGRNPredictor)
    window = 1 if isinstance(predictor, FGRNPredictor) else predictor.network.frames
    clips = clips_of(data, acquisitions, true, window, 1)
    store = PictureStore(data.frames, CAMERA, predictor.preprocessing, pictures)
    readable = store.healthy(clips.frames).all(axis=1)
    frames, targets = clips.frames[readable], clips.targets[readable, 0].tolist()
    curves = [true[index] for index in targets]
    seen = store.pictures(frames)
    predicted = list(predictor.predict_pictures(seen[:, -1] if fgrn else seen))
    if fgrn:
        spacing = predictor.metadata["spacing_mm"]
        predicted = [
            points[: max(2, int(arc_length(curve)[-1] / spacing) + 1)]
            for points, curve in zip(predicted, curves, strict=True)
        ]
    pairs = list(zip(predicted, curves, strict=True))
    errors = [curve_metrics(points, curve) for points, curve in pairs]
    along = [distances_along(points, curve, SPACING_MM) for points, curve in pairs]
    by_place = [[float(one[k]) for one in along if len(one) > k] for k in range(max(map(len, along)))]
    by_place = [values for values in by_place if len(values) >= min(_FEWEST, len(errors))]
    pixels = [
        off_line_px(data.camera_a, points, data.undistort(CAMERA, data.frames[index].polyline(CAMERA)))
        for points, index in zip(predicted, targets, strict=True)
        if data.camera_a is not None
    ]
    began = time.process_time()
    for index in targets[:_TIMED]:
        image = data.frames[index].image(CAMERA)
        if isinstance(predictor, FGRNPredictor):
            predictor.predict(image)
        else:
            predictor.predict([image])
    spent = time.process_time() - began
    chosen = _at_quantiles([one["max_ed"] for one in errors], _SHAPE_QUANTILES)
    figures = {
        **{name: mean_and_spread([one[name] for one in errors]) for name in SHAPE_METRICS},
        "length_error_mm": mean_and_spread([abs(float(arc_length(a)[-1] - arc_length(b)[-1])) for a, b in pairs]),
        "reprojection_px": mean_and_spread(pixels) if pixels else None,
        "along_mm": [SPACING_MM * k for k in range(len(by_place))],
        "along_error_mm": [float(np.mean(values)) for values in by_place],
        "frames": len(errors),
        "ms_a_frame": 1e3 * spent / max(1, min(_TIMED, len(targets))),
        "skipped": store.damaged,
    }
    examples = {f"predicted{k}": pairs[place][0] for k, place in enumerate(chosen)}
    examples |= {f"true{k}": pairs[place][1] for k, place in enumerate(chosen)}
    return figures, {"frames": np.array([targets[place] for place in chosen]), **examples}


def off_line_px(camera: Camera, curve_mm: Array, line_px: Array) -> float:
    """Returns the mean distance (px) of an (n, 3) mm curve's projection from an annotated (m, 2) px line."""
    distances, _ = cKDTree(resample(line_px, spacing=0.5)).query(camera.project(curve_mm))
    return float(np.mean(distances))


def evaluate_segmentation(
    predictor: SegmentationPredictor,
    data: Dataset,
    acquisitions: Sequence[str],
    images: int = 0,
    pictures: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Compares predicted masks with the annotated ones, at the camera's and at the network's resolution.

    Args:
        images: evenly chosen; 0: all.
        pictures: folder that keeps prepared pictures; None: in memory.
        progress: called with the number of an image and of all, after each.

    Returns:
        Figures: the metrics in per cent, "dice_small" at the network's resolution, "by_kind" of wire and fluid the
        Dice, sizes in px, "images", "ms_an_image" of processor time and "skipped" images. Arrays: "dice" (3,), and
        "image<k>", "true<k>" and "predicted<k>" (h, w).
    """
    stores = [PictureStore(data.frames, camera, predictor.preprocessing, pictures) for camera in VIEWS]
    width = float(predictor.metadata["mask_px"])
    items = images_of(data, acquisitions, images).tolist()
    scores: list[dict[str, float]] = []
    small: list[float] = []
    by_kind: dict[str, list[float]] = {}
    places, spent = [], 0.0
    for number, item in enumerate(items):
        camera, index = divmod(item, len(data.frames))
        if not stores[camera].healthy(np.array([index]))[0]:
            continue
        picture = stores[camera].pictures(np.array(index))
        began = time.process_time()
        chances = predictor.chances(picture)
        large = predictor.enlarged(chances) >= 0.5
        spent += time.process_time() - began
        frame = data.frames[index]
        mask = frame.mask(VIEWS[camera], width)
        scores.append(segmentation_metrics(large, mask))
        small.append(dice(chances >= 0.5, averaged(mask, len(chances)) >= _HALF))
        kind = f"{frame.wire}, {'fluid' if frame.fluid else 'dry'}"
        by_kind.setdefault(kind, []).append(scores[-1]["dice"])
        places.append((frame, VIEWS[camera]))
        if progress is not None:
            progress(number, len(items))
    if not scores:
        raise ValueError("there is no image to evaluate on: the data set's part is empty, or none of it can be read")
    chosen = _at_quantiles([one["dice"] for one in scores], _MASK_QUANTILES)
    examples: dict[str, Any] = {"dice": np.array([scores[place]["dice"] for place in chosen])}
    for k, place in enumerate(chosen):
        frame, view = places[place]
        image = frame.image(view)
        examples |= {f"image{k}": image, f"true{k}": frame.mask(view, width), f"predicted{k}": predictor.predict(image)}
    figures = {
        **{name: _percent([one[name] for one in scores]) for name in SEGMENTATION_METRICS},
        "dice_small": _percent(small),
        "by_kind": {kind: _percent(by_kind[kind]) for kind in sorted(by_kind)},
        "size_px": predictor.preprocessing.size_px,
        "source_px": predictor.preprocessing.source_px,
        "mask_px": width,
        "images": len(scores),
        "ms_an_image": 1e3 * spent / len(scores),
        "skipped": [name for store in stores for name in store.damaged],
    }
    return figures, examples


def _at_quantiles(values: Sequence[float], quantiles: Sequence[float]) -> list[int]:
    """Places of the values that lie at quantiles."""
    order = np.argsort(values)
    return [int(order[round(share * (len(order) - 1))]) for share in quantiles]


def _percent(values: Sequence[float]) -> list[float]:
    return [100.0 * figure for figure in mean_and_spread(values)]


def _pair(predicted: ArrayLike, true: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    a, b = np.asarray(predicted), np.asarray(true)
    if a.shape != b.shape or a.ndim != 2:
        raise ValueError(f"expected two masks of the same height and width, got shapes {a.shape} and {b.shape}")
    return a != 0, b != 0


def _ratio(part: np.integer | int | float, whole: np.integer | int | float) -> float:
    return float(part) / float(whole) if whole else 1.0


def dice(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the Dice coefficient, 0 to 1, of two (h, w) masks whose wire is not 0."""
    a, b = _pair(predicted, true)
    return _ratio(2 * np.count_nonzero(a & b), np.count_nonzero(a) + np.count_nonzero(b))


def foreground_iou(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the intersection over union of the wire, 0 to 1, of two (h, w) masks."""
    a, b = _pair(predicted, true)
    return _ratio(np.count_nonzero(a & b), np.count_nonzero(a | b))


def mean_iou(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the mean of the intersections over unions of wire and background, 0 to 1, of two (h, w) masks."""
    a, b = _pair(predicted, true)
    return (foreground_iou(a, b) + foreground_iou(~a, ~b)) / 2


def centreline_dice(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the centreline Dice coefficient, 0 to 1, of two (h, w) masks."""
    from skimage.morphology import skeletonize

    a, b = _pair(predicted, true)
    if not a.any() or not b.any():
        return float(a.any() == b.any())
    line_a, line_b = skeletonize(a), skeletonize(b)
    precision = _ratio(np.count_nonzero(line_a & b), np.count_nonzero(line_a))
    sensitivity = _ratio(np.count_nonzero(line_b & a), np.count_nonzero(line_b))
    return _ratio(2 * precision * sensitivity, precision + sensitivity) if precision + sensitivity else 0.0


def segmentation_metrics(predicted: ArrayLike, true: ArrayLike) -> dict[str, float]:
    """Returns all of them by name: dice, iou_foreground, miou, jaccard and centreline_dice, 0 to 1."""
    return {
        "dice": dice(predicted, true),
        "iou_foreground": foreground_iou(predicted, true),
        "miou": mean_iou(predicted, true),
        "jaccard": foreground_iou(predicted, true),
        "centreline_dice": centreline_dice(predicted, true),
    }
