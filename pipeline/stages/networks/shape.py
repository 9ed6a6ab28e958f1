"""Shape jobs: a network that predicts the wire in space, trained and judged on acquisitions it has never seen."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.training import PREDICTOR, NetworkJob, train_network
from pipeline.store.atomic_files import atomic_path, write_json

if TYPE_CHECKING:
    from guide3d.geometry.camera import Camera

PRELOAD = ("guide3d.train", "guide3d.geometry.metrics")
RECORD, EXAMPLES = "shape.json", "examples.npz"
METRICS = ("max_ed", "mete", "mers", "frechet", "chamfer")
SPACING_MM = 5.0  # of the error along the wire
SHOWN = (0.1, 0.5, 0.9)  # quantiles of MaxED whose frames are shown
_TIMED = 20  # frames that the speed is measured with


def learn_shape(job: NetworkJob, report: Report) -> dict[str, Any]:
    """Trains a network and compares its curves with the true ones of the test acquisitions.

    Args:
        job: what to train.
        report: takes the progress.

    Returns:
        Means and standard deviations of the distances, the error along the wire, and what the training took.
    """
    file = job.folder / RECORD
    if file.is_file():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    from guide3d.dataset.dataset import split
    from guide3d.geometry.metrics import curve_metrics, distances_along
    from guide3d.geometry.polyline import arc_length
    from guide3d.learning.picture_store import PictureStore
    from guide3d.learning.predictor import FGRNPredictor, ShapePredictor
    from guide3d.learning.shape_samples import CAMERA, clips_of, curve_of

    training = train_network(job, report)
    data = open_dataset(job.guide3d)
    true = {index: curve for index, frame in enumerate(data.frames) if (curve := curve_of(frame)) is not None}
    parts = split(data, seed=job.split_seed)
    fgrn = job.network == "fgrn"
    predictor: Any = (FGRNPredictor if fgrn else ShapePredictor).load(job.folder / PREDICTOR, report.device)
    clips = clips_of(data, parts.test, true, 1 if fgrn else predictor.network.frames, 1)
    store = PictureStore(data.frames, CAMERA, predictor.preprocessing, job.pictures)
    readable = store.healthy(clips.frames).all(axis=1)
    frames, targets = clips.frames[readable], clips.targets[readable, 0].tolist()
    pictures = store.pictures(frames)
    predicted = list(predictor.predict_pictures(pictures[:, -1] if fgrn else pictures))
    if fgrn:  # it has no stop: its points count as far as the true wire goes
        spacing = predictor.metadata["spacing_mm"]
        lengths = [arc_length(true[index])[-1] for index in targets]
        predicted = [
            points[: max(2, int(length / spacing) + 1)] for points, length in zip(predicted, lengths, strict=True)
        ]
    told = [curve_metrics(points, true[index]) for points, index in zip(predicted, targets, strict=True)]
    along = [distances_along(points, true[index], SPACING_MM) for points, index in zip(predicted, targets, strict=True)]
    reach = max(map(len, along))
    by_place = [[float(one[k]) for one in along if len(one) > k] for k in range(reach)]
    ends = [arc_length(p)[-1] - arc_length(true[i])[-1] for p, i in zip(predicted, targets, strict=True)]
    camera = data.camera_a
    pixels = [
        off_line_px(camera, points, data.frames[index].polyline(CAMERA))
        for points, index in zip(predicted, targets, strict=True)
        if camera is not None
    ]
    began = time.process_time()
    for index in targets[:_TIMED]:
        image = data.frames[index].image(CAMERA)
        predictor.predict(image if fgrn else [image])
    spent = time.process_time() - began
    order = np.argsort([one["max_ed"] for one in told])
    chosen = [int(order[round(share * (len(order) - 1))]) for share in SHOWN]
    with atomic_path(job.folder / EXAMPLES) as temporary:
        arrays: dict[str, Any] = {f"predicted{k}": predicted[place] for k, place in enumerate(chosen)}
        arrays |= {f"true{k}": true[targets[place]] for k, place in enumerate(chosen)}
        np.savez(temporary, frames=np.array([targets[place] for place in chosen]), **arrays)
    outcome = {
        **{name: _spread([one[name] for one in told]) for name in METRICS},
        "length_error_mm": _spread([abs(float(x)) for x in ends]),
        "reprojection_px": _spread(pixels) if pixels else None,
        "along_mm": [SPACING_MM * k for k, values in enumerate(by_place) if len(values) >= min(5, len(told))],
        "along_error_mm": [float(np.mean(values)) for values in by_place if len(values) >= min(5, len(told))],
        "frames": len(told),
        "acquisitions": len(parts.test),
        "training_frames": int(predictor.metadata["training_frames"]),
        "parameters": sum(weight.numel() for weight in predictor.network.parameters()),
        "epochs": len(training["rows"]),
        "best_epoch": training["best_epoch"],
        "cpu_min": training["rows"][-1]["cpu_s"] / 60,
        "ms_a_frame": 1e3 * spent / max(1, min(_TIMED, len(targets))),
        "curve": [[row["epoch"], row["loss"], row["validation"]] for row in training["rows"]],
        "skipped": store.damaged,
    }
    write_json(file, outcome)
    return outcome


def off_line_px(camera: Camera, curve_mm: np.ndarray, line: np.ndarray) -> float:
    """Mean distance of a curve's projection from the annotated line, px.

    Args:
        camera: that sees it.
        curve_mm: (n, 3).
        line: (m, 2) px.
    """
    from scipy.spatial import cKDTree

    from guide3d.geometry.polyline import resample

    return float(cKDTree(resample(line, spacing=0.5)).query(camera.project(curve_mm))[0].mean())


def _spread(values: list[float]) -> list[float]:
    return [float(np.mean(values)), float(np.std(values))]
