"""Comparison job: SplineFormer and a traced segmentation read the same unseen images, plain and disturbed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.training import PREDICTOR
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from guide3d.dataset.frame import Frame
    from guide3d.geometry.camera import Camera

EXAMPLES = "examples.npz"
MASK_PX = 6.0  # width of a drawn curve, as annotated
SHOWN = (0.5, 0.95)  # quantiles of the rival's error whose images are shown, and one that is partly hidden
_LENGTHS = ("tip", "mean", "max")

Read = tuple[np.ndarray | None, int, np.ndarray | None]  # the curve, discontinuities, and the mask where there is one
Reader = Callable[[np.ndarray, str], Read]  # image and camera


@dataclass(frozen=True)
class ComparisonJob:
    """Readers to compare.

    Attributes:
        folder: gets a record a disturbance, and examples.
        guide3d: folder of the stage guide3d.
        variants: name of a variant to its folder.
        rival: name of the segmentation network.
        rival_folder: of it.
        disturbances: to read under.
        test_images: 0: all.
        disturbed_images: under each disturbance; 0: all.
        split_seed: of the split.
        seed: of the disturbances.
    """

    folder: Path
    guide3d: Path
    variants: dict[str, Path]
    rival: str
    rival_folder: Path
    disturbances: tuple[str, ...]
    test_images: int
    disturbed_images: int
    split_seed: int
    seed: int


def compare(job: ComparisonJob, report: Report) -> dict[str, Any]:
    """Lets every reader read the test images.

    Args:
        job: what to compare.
        report: takes the progress.

    Returns:
        DisturbanceSettings to reader to means and standard deviations, and the errors of single images.
    """
    data = open_dataset(job.guide3d)
    readers = _readers(job, data, report.device)
    outcome: dict[str, Any] = {}
    for number, kind in enumerate(job.disturbances):
        file = job.folder / f"{kind}.json"
        if not file.is_file():
            count = job.test_images if kind == "none" else job.disturbed_images
            write_json(file, _under(kind, count, job, data, readers, _part(report, number, len(job.disturbances))))
        outcome[kind] = json.loads(file.read_text(encoding="utf-8"))
    if not (job.folder / EXAMPLES).is_file():
        _keep_examples(job, data, readers, outcome)
    return outcome


def _part(report: Report, number: int, of: int) -> Callable[[float, str], None]:
    return lambda share, words: report((number + share) / of, words)


def _readers(job: ComparisonJob, data: Dataset, device: str) -> dict[str, Reader]:
    from guide3d.dataset.dataset import split
    from guide3d.learning.predictor import SegmentationPredictor
    from splineformer.comparison.skeleton import trace_mask
    from splineformer.predictor import Predictor

    file = job.rival_folder / PREDICTOR
    if not file.is_file():
        raise StageError(f"{file} is missing: let the stage segmentation train {job.rival}, or choose another rival")
    segmenter = SegmentationPredictor.load(file, device)
    learnt = [index for name in split(data, seed=job.split_seed).train for index in data.acquisitions[name]]
    ends = {camera: np.mean([data.frames[i].polyline(camera)[-1] for i in learnt], axis=0) for camera in "ab"}

    def traced(image: np.ndarray, camera: str) -> Read:
        mask = segmenter.predict(image)
        told = trace_mask(mask, ends[camera])
        return told.points_px, told.discontinuities, mask

    readers: dict[str, Reader] = {job.rival: traced}
    for name, folder in job.variants.items():
        predictor = Predictor.load(folder / PREDICTOR, device=device)

        def read(image: np.ndarray, camera: str, predictor: Predictor = predictor) -> Read:
            told = predictor(image)
            return (None if told.tokens is None else told.points()), 0, None

        readers[name] = read
    return readers


def _items(count: int, job: ComparisonJob, data: Dataset) -> list[tuple[Frame, str]]:
    from guide3d.dataset.dataset import VIEWS, images_of, split

    items = images_of(data, split(data, seed=job.split_seed).test, count).tolist()
    return [(data.frames[item % len(data.frames)], VIEWS[item // len(data.frames)]) for item in items]


def _disturbed(kind: str, frame: Frame, camera: str, number: int, job: ComparisonJob) -> np.ndarray:
    from splineformer.comparison.disturbances import KINDS, disturbed

    generator = np.random.default_rng((job.seed, KINDS.index(kind), number))
    return disturbed(kind, frame.image(camera), frame.polyline(camera), generator)


def _under(
    kind: str,
    count: int,
    job: ComparisonJob,
    data: Dataset,
    readers: dict[str, Reader],
    report: Callable[[float, str], None],
) -> dict[str, Any]:
    """What every reader makes of the images under one disturbance."""
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in readers}
    missed, spent = dict.fromkeys(readers, 0), dict.fromkeys(readers, 0.0)
    gaps: dict[str, list[int]] = {name: [] for name in readers}
    items = _items(count, job, data)
    for number, (frame, camera) in enumerate(items):
        report(number / len(items), f"{kind}: image {number + 1} of {len(items)}")
        try:
            image = _disturbed(kind, frame, camera, number, job)
        except ValueError:
            continue  # the training has named the images that cannot be read
        scale = mm_per_px(frame, data.camera_a if camera == "a" else data.camera_b)
        for name, reader in readers.items():
            began = time.process_time()
            points, discontinuities, _ = reader(image, camera)
            spent[name] += time.process_time() - began
            gaps[name].append(discontinuities)
            if points is None:
                missed[name] += 1
                continue
            rows[name].append(_errors(points, frame, camera, scale) | {"image": number})
    return {name: _summary(rows[name], gaps[name], missed[name], spent[name]) for name in readers}


def mm_per_px(frame: Frame, camera: Camera | None) -> float | None:
    """Millimetres that a pixel is worth where the wire is, or else at the world's origin; None without a camera."""
    if camera is None:
        return None
    points = frame.curve_mm if frame.curve_mm is not None else np.zeros((1, 3))
    return float(np.mean(camera.depth_mm(points)) / (0.5 * (camera.K[0, 0] + camera.K[1, 1])))


def _errors(points: np.ndarray, frame: Frame, camera: str, scale: float | None) -> dict[str, float]:
    from guide3d.dataset.masks import strip_mask
    from guide3d.learning.segmentation_metrics import dice
    from splineformer.comparison.curve_errors import curve_errors

    errors = curve_errors(points, frame.polyline(camera))
    told = dict(errors)
    if scale is not None:
        told |= {f"{name}_mm": scale * errors[f"{name}_px"] for name in _LENGTHS}
    width, height = frame.size_px[camera]
    drawn = strip_mask(points, width, height, MASK_PX)
    return told | {"dice_pct": 100 * dice(drawn, frame.mask(camera, MASK_PX))}


def _summary(rows: list[dict[str, float]], gaps: list[int], missed: int, spent: float) -> dict[str, Any]:
    told: dict[str, Any] = {
        name: [float(np.mean([row[name] for row in rows])), float(np.std([row[name] for row in rows]))]
        for name in (rows[0] if rows else {})
        if name != "image"
    }
    images = len(gaps)
    return told | {
        "median_px": float(np.median([row["mean_px"] for row in rows])) if rows else None,
        "median_tip_px": float(np.median([row["tip_px"] for row in rows])) if rows else None,
        "discontinuities": float(np.mean(gaps)) if gaps else None,
        "read_pct": 100.0 * (images - missed) / images if images else None,
        "ms_an_image": 1e3 * spent / images if images else None,
        "n": images,
        "mean_errors_px": [row["mean_px"] for row in rows],
        "tip_errors_px": [row["tip_px"] for row in rows],
        "images": [row["image"] for row in rows],
    }


def _keep_examples(job: ComparisonJob, data: Dataset, readers: dict[str, Reader], outcome: dict[str, Any]) -> None:
    """Images with what every reader makes of them: an ordinary one, one that is hard for the rival, a hidden one."""
    from splineformer.attention import attention_map
    from splineformer.predictor import Predictor

    plain = outcome["none"][job.rival]
    items = _items(job.test_images, job, data)
    order = np.argsort(plain["mean_errors_px"])
    chosen = [("none", plain["images"][order[round(share * (len(order) - 1))]]) for share in SHOWN if len(order)]
    if not chosen:  # the rival has found no wire at all
        chosen = [("none", 0)]
    other = [kind for kind in job.disturbances if kind != "none"]
    if other:
        kind = "occlusion" if "occlusion" in other else other[-1]
        chosen.append((kind, 0))
    disturbed_items = _items(job.disturbed_images, job, data)
    networks = {name: Predictor.load(folder / PREDICTOR) for name, folder in job.variants.items()}
    arrays: dict[str, Any] = {"kinds": np.array([kind for kind, _ in chosen])}
    for place, (kind, number) in enumerate(chosen):
        frame, camera = (items if kind == "none" else disturbed_items)[number]
        image = _disturbed(kind, frame, camera, number, job)
        arrays |= {f"image{place}": image, f"true{place}": frame.polyline(camera)}
        for name, reader in readers.items():
            points, _, mask = reader(image, camera)
            arrays[f"points{place}_{name}"] = np.zeros((0, 2)) if points is None else points
            if mask is not None:
                arrays[f"mask{place}"] = mask
        for name, predictor in networks.items():
            told = predictor(image)
            arrays[f"control{place}_{name}"] = np.zeros((0, 2)) if told.tokens is None else told.control_points_px
            seen = attention_map(predictor.network, image)
            arrays[f"attention{place}_{name}"] = (255 * seen[::4, ::4]).round().astype(np.uint8)
    with atomic_path(job.folder / EXAMPLES) as temporary:
        np.savez_compressed(temporary, **arrays)
