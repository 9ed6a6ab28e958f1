"""Segmentation jobs: a network that finds the wire's pixels, trained and judged on acquisitions it has never seen."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.training import PREDICTOR, NetworkJob, train_network
from pipeline.store.atomic_files import atomic_path, write_json

PRELOAD = ("guide3d.train", "guide3d.learning.segmentation_metrics")
RECORD, EXAMPLES = "segmentation.json", "examples.npz"
METRICS = ("dice", "iou_foreground", "miou", "jaccard", "centreline_dice")
SHOWN = (0.05, 0.5, 0.95)  # quantiles of Dice whose images are shown
_HALF = 128


def learn_segmentation(job: NetworkJob, report: Report) -> dict[str, Any]:
    """Trains a network and compares its masks with those of the test acquisitions, both cameras.

    Args:
        job: what to train.
        report: takes the progress.

    Returns:
        Means and standard deviations of the metrics, at the camera's and at the network's resolution, and what the
        training took.
    """
    file = job.folder / RECORD
    if file.is_file():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    from guide3d.dataset.dataset import VIEWS, images_of, split
    from guide3d.learning.picture_store import PictureStore
    from guide3d.learning.predictor import SegmentationPredictor
    from guide3d.learning.preprocessing import averaged
    from guide3d.learning.segmentation_metrics import dice, segmentation_metrics

    training = train_network(job, report)
    data = open_dataset(job.guide3d)
    parts = split(data, seed=job.split_seed)
    predictor = SegmentationPredictor.load(job.folder / PREDICTOR, report.device)
    stores = [PictureStore(data.frames, camera, predictor.preprocessing, job.pictures) for camera in VIEWS]
    width = float(predictor.metadata["mask_px"])
    items = images_of(data, parts.test, job.test_images).tolist()
    told, small, kinds, places, spent = [], [], [], [], 0.0
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
        told.append(segmentation_metrics(large, mask))
        small.append(dice(chances >= 0.5, averaged(mask, len(chances)) >= _HALF))
        kinds.append(f"{frame.wire}, {'fluid' if frame.fluid else 'dry'}")
        places.append((camera, index))
        report(0.9 + 0.1 * number / len(items), f"image {number + 1} of {len(items)}")
    order = np.argsort([one["dice"] for one in told])
    chosen = [int(order[round(share * (len(order) - 1))]) for share in SHOWN]
    arrays: dict[str, Any] = {}
    for k, place in enumerate(chosen):
        camera, index = places[place]
        image = data.frames[index].image(VIEWS[camera])
        arrays[f"image{k}"], arrays[f"true{k}"] = image, data.frames[index].mask(VIEWS[camera], width)
        arrays[f"predicted{k}"] = predictor.predict(image)
    with atomic_path(job.folder / EXAMPLES) as temporary:
        np.savez_compressed(temporary, dice=np.array([told[place]["dice"] for place in chosen]), **arrays)
    outcome = {
        **{name: _percent([one[name] for one in told]) for name in METRICS},
        "dice_small": _percent(small),
        "by_kind": {
            kind: _percent([one["dice"] for one, own in zip(told, kinds, strict=True) if own == kind])
            for kind in sorted(set(kinds))
        },
        "size_px": predictor.preprocessing.size_px,
        "source_px": predictor.preprocessing.source_px,
        "mask_px": width,
        "images": len(told),
        "acquisitions": len(parts.test),
        "training_images": int(predictor.metadata["training_images"]),
        "parameters": sum(weight.numel() for weight in predictor.network.parameters()),
        "epochs": len(training["rows"]),
        "best_epoch": training["best_epoch"],
        "cpu_min": training["rows"][-1]["cpu_s"] / 60,
        "ms_an_image": 1e3 * spent / len(told),
        "curve": [[row["epoch"], row["loss"], row["validation"]] for row in training["rows"]],
        "skipped": [name for store in stores for name in store.damaged],
    }
    write_json(file, outcome)
    return outcome


def _percent(values: list[float]) -> list[float]:
    return [100.0 * float(np.mean(values)), 100.0 * float(np.std(values))]
