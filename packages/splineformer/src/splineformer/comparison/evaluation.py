"""Evaluation of readers on the same images: curves by a network, and curves traced in the mask of a segmentation."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from guide3d.dataset.dataset import VIEWS, Dataset
from guide3d.dataset.frame import Frame, strip_mask
from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array, arc_length, at_length, checked, resample
from guide3d.learning.evaluation import dice
from splineformer.attention import attention_map
from splineformer.comparison.skeleton import trace_mask

if TYPE_CHECKING:
    from guide3d.learning.predictor import SegmentationPredictor
    from splineformer.predictor import Predictor


SAMPLES = 100


KINDS = ("none", "noise", "low_contrast", "occlusion")
NOISE_SD = 12.0  # grey levels, at the camera's resolution
GAIN = 0.35  # of the contrast that is left
DETECTOR_SD = 2.0  # grey levels of noise that do not shrink with the contrast
BARS = 3
BAR_PX = (30.0, 70.0)  # side of a bar over a 1,024 px image
_COVERED = (0.15, 0.85)  # shares of the wire's length where bars may lie: tip and end stay in sight
Image = NDArray[np.uint8]
MASK_PX = 6.0  # width of a drawn curve, as annotated
SHOWN = (0.5, 0.95)  # quantiles of a reader's mean error whose images are examples
_LENGTHS = ("tip", "mean", "max")


def curve_errors(predicted_px: ArrayLike, true_px: ArrayLike) -> dict[str, float]:
    """Compares two curves: tip_px, mean_px, max_px and chamfer_px.

    Args:
        predicted_px, true_px: (n, 2) and (m, 2) points, tip first.

    Raises:
        ValueError: a curve of fewer than two different points.
    """
    a = resample(checked(predicted_px, 2, "predicted curve"), count=SAMPLES)
    b = resample(checked(true_px, 2, "true curve"), count=SAMPLES)
    along = np.linalg.norm(a - b, axis=1)
    apart = cdist(a, b)
    return {
        "tip_px": float(along[0]),
        "mean_px": float(along.mean()),
        "max_px": float(along.max()),
        "chamfer_px": float((apart.min(axis=1).mean() + apart.min(axis=0).mean()) / 2),
    }


def disturbed(kind: str, image: Image, wire_px: Array, generator: np.random.Generator) -> Image:
    """Disturbs an image.

    Args:
        kind: one of `KINDS`.
        image: (h, w) uint8.
        wire_px: (n, 2) the true wire, tip first: bars lie on it.

    Returns:
        (h, w) uint8, a new image unless the kind is "none".

    Raises:
        ValueError: another kind.
    """
    if kind == "none":
        return image
    if kind == "occlusion":
        return _hidden(image, wire_px, generator)
    levels = image.astype(np.float32)
    if kind == "noise":
        levels += NOISE_SD * generator.standard_normal(image.shape, np.float32)
    elif kind == "low_contrast":
        middle = levels.mean()
        levels = middle + GAIN * (levels - middle) + DETECTOR_SD * generator.standard_normal(image.shape, np.float32)
    else:
        raise ValueError(f"unknown disturbance '{kind}'; there are {', '.join(KINDS)}")
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)


def _hidden(image: Image, wire_px: Array, generator: np.random.Generator) -> Image:
    covered = image.copy()
    length = arc_length(wire_px)[-1]
    height, width = image.shape
    for share in generator.uniform(*_COVERED, BARS):
        x, y = at_length(wire_px, [share * length])[0]
        half = generator.uniform(*BAR_PX, 2) * max(image.shape) / 1024 / 2
        rows = slice(max(int(y - half[1]), 0), min(int(y + half[1]) + 1, height))
        columns = slice(max(int(x - half[0]), 0), min(int(x + half[0]) + 1, width))
        covered[rows, columns] = int(generator.uniform(30, 180))
    return covered


class ReadCurve(NamedTuple):
    """A curve that a reader found."""

    points_px: Array | None  # (n, 2) tip first; None: no wire
    discontinuities: int = 0  # gaps of the mask
    mask: NDArray[np.uint8] | None = None  # (h, w), of a reader that traces one


Reader = Callable[[Image, str], ReadCurve]  # of an image and its camera, "a" or "b"


def curve_reader(predictor: Predictor) -> Reader:
    """Reads curves by a SplineFormer."""

    def read(image: Image, camera: str) -> ReadCurve:
        prediction = predictor(image)
        return ReadCurve(None if prediction.tokens is None else prediction.points())

    return read


def mask_reader(segmenter: SegmentationPredictor, data: Dataset, training: Sequence[str]) -> Reader:
    """Traces the masks of a segmentation.

    Args:
        training: acquisitions whose wires show where wires enter the images: the other end is the tip.
    """
    frames = [data.frames[index] for name in training for index in data.acquisitions[name]]
    ends = {camera: np.mean([frame.polyline(camera)[-1] for frame in frames], axis=0) for camera in VIEWS}

    def read(image: Image, camera: str) -> ReadCurve:
        mask = segmenter.predict(image)
        traced = trace_mask(mask, ends[camera])
        return ReadCurve(traced.points_px, traced.discontinuities, mask)

    return read


def frame_of(data: Dataset, item: int) -> tuple[Frame, str]:
    """The frame and the camera of an image, numbered as `guide3d.dataset.images_of` numbers them."""
    return data.frames[item % len(data.frames)], VIEWS[item // len(data.frames)]


def disturbed_image(data: Dataset, item: int, kind: str, number: int, seed: int) -> Image:
    """An image under a disturbance whose draws depend on the seed, the kind and the image's number alone."""
    frame, camera = frame_of(data, item)
    generator = np.random.default_rng((seed, KINDS.index(kind), number))
    return disturbed(kind, frame.image(camera), frame.polyline(camera), generator)


def evaluate_readers(
    readers: Mapping[str, Reader],
    data: Dataset,
    items: Sequence[int],
    kind: str,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Lets readers read images under one disturbance.

    Args:
        items: images; those that cannot be read are left out.
        kind: of `disturbances.KINDS`.
        progress: called with the number of an image and of all, before each.

    Returns:
        By reader: mean and standard deviation of each of `curve_errors`, the lengths in mm where there is a camera,
        and "dice_pct"; medians, "discontinuities", "read_pct", "ms_an_image" of processor time, "n", and the errors of
        single images, "images" being their numbers.
    """
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in readers}
    gaps: dict[str, list[int]] = {name: [] for name in readers}
    spent = dict.fromkeys(readers, 0.0)
    for number, item in enumerate(items):
        if progress is not None:
            progress(number, len(items))
        frame, camera = frame_of(data, item)
        try:
            image = disturbed_image(data, item, kind, number, seed)
        except ValueError:
            continue  # the training has named the images that cannot be read
        scale = mm_per_px(frame, data.camera_a if camera == "a" else data.camera_b)
        for name, reader in readers.items():
            began = time.process_time()
            points, discontinuities, _ = reader(image, camera)
            spent[name] += time.process_time() - began
            gaps[name].append(discontinuities)
            if points is not None:
                rows[name].append(_errors(points, frame, camera, scale) | {"image": number})
    return {name: _summary(rows[name], gaps[name], spent[name]) for name in readers}


def mm_per_px(frame: Frame, camera: Camera | None) -> float | None:
    """Millimetres that a pixel is worth where the wire is, or else at the world's origin; None without a camera."""
    if camera is None:
        return None
    points = frame.curve_mm if frame.curve_mm is not None else np.zeros((1, 3))
    # depths are negative where a camera is written with its scale below zero, as that of a C-arm
    return float(abs(np.mean(camera.depth_mm(points))) / (0.5 * (camera.K[0, 0] + camera.K[1, 1])))


def _errors(points: Array, frame: Frame, camera: str, scale: float | None) -> dict[str, float]:
    errors = curve_errors(points, frame.polyline(camera))
    if scale is not None:
        errors |= {f"{name}_mm": scale * errors[f"{name}_px"] for name in _LENGTHS}
    drawn = strip_mask(points, *frame.size_px[camera], MASK_PX)
    return errors | {"dice_pct": 100 * dice(drawn, frame.mask(camera, MASK_PX))}


def _summary(rows: list[dict[str, float]], gaps: list[int], spent: float) -> dict[str, Any]:
    values = {name: [row[name] for row in rows] for name in (rows[0] if rows else ("mean_px", "tip_px", "image"))}
    numbers, images = values.pop("image"), len(gaps)
    return {
        **{name: [float(np.mean(column)), float(np.std(column))] for name, column in values.items() if rows},
        "median_px": float(np.median(values["mean_px"])) if rows else None,
        "median_tip_px": float(np.median(values["tip_px"])) if rows else None,
        "discontinuities": float(np.mean(gaps)) if gaps else None,
        "read_pct": 100.0 * len(rows) / images if images else None,
        "ms_an_image": 1e3 * spent / images if images else None,
        "n": images,
        "mean_errors_px": values["mean_px"],
        "tip_errors_px": values["tip_px"],
        "images": numbers,
    }


def examples_of(
    errors: Mapping[str, Any], items: Sequence[int], disturbed_items: Sequence[int], kinds: Sequence[str]
) -> list[tuple[str, int, int]]:
    """Chooses images to show: of plain ones those at quantiles of a reader's error, then the first disturbed one.

    Args:
        errors: of the reader on plain images, as `evaluate_readers` gives them.
        kinds: disturbances; of several the occlusion is shown, or else the last.

    Returns:
        Kind, number and item each.
    """
    order = np.argsort(errors["mean_errors_px"])
    numbers = [errors["images"][order[round(share * (len(order) - 1))]] for share in SHOWN if len(order)]
    examples = [("none", number, items[number]) for number in numbers or [0]]  # the reader may have found no wire
    other = [kind for kind in kinds if kind != "none"]
    if other:
        examples.append(("occlusion" if "occlusion" in other else other[-1], 0, disturbed_items[0]))
    return examples


def example_arrays(
    examples: Sequence[tuple[str, int, int]],
    data: Dataset,
    readers: Mapping[str, Reader],
    predictors: Mapping[str, Predictor],
    seed: int = 0,
) -> dict[str, Any]:
    """What readers make of chosen images.

    Returns:
        "kinds", and of image k: "image<k>" (h, w), "true<k>" (n, 2) px, "points<k>_<reader>" (m, 2) px, "mask<k>"
        (h, w), and of each network "control<k>_<name>" (m, 2) px and "attention<k>_<name>" (h / 4, w / 4) of 0 to 255.
    """
    arrays: dict[str, Any] = {"kinds": np.array([kind for kind, _, _ in examples])}
    for place, (kind, number, item) in enumerate(examples):
        frame, camera = frame_of(data, item)
        image = disturbed_image(data, item, kind, number, seed)
        arrays |= {f"image{place}": image, f"true{place}": frame.polyline(camera)}
        for name, reader in readers.items():
            points, _, mask = reader(image, camera)
            arrays[f"points{place}_{name}"] = np.zeros((0, 2)) if points is None else points
            if mask is not None:
                arrays[f"mask{place}"] = mask
        for name, predictor in predictors.items():
            prediction = predictor(image)
            control = np.zeros((0, 2)) if prediction.tokens is None else prediction.control_points_px
            seen = attention_map(predictor, image)
            arrays[f"control{place}_{name}"] = control
            arrays[f"attention{place}_{name}"] = (255 * seen[::4, ::4]).round().astype(np.uint8)
    return arrays
