"""Segmentation networks and the reader on images of one data set, of random fluoroscopy and of a real C-arm.

    python benchmarks/guide3d/segmenters.py DATASET NETWORK.pt... [--images 60] [--real FOLDER CURVES] [--seed 3000003]

A NETWORK is a `predictor.pt` of `python -m guide3d.train`; guide3d's shipped reader is always a row. Every network
marks the same images of the data set's test part (split seed 0), evenly chosen: "as taken", and drawn by random
fluoroscopy along the same wires, without clutter and with it. Real images are those of `real_xray.py`, and are resized
to the side that the network was trained for. Masks are compared with the annotated line, drawn 6 px wide.

Prints one JSON line a network: for every kind of images the mean Dice coefficient, the recall (share of the line within
4 px of the mask), the pixels marked further than 4 px from the line, and the interval of the Dice coefficient (95 %,
bootstrap over images); and the processor time of an image in ms.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch
from numpy.typing import NDArray
from real_xray import NEAR_PX, annotated_images, drawn

from guide3d.dataset.dataset import VIEWS, Dataset, images_of, split
from guide3d.geometry.polyline import resample
from guide3d.learning.predictor import SegmentationPredictor
from guide3d.learning.segmentation_metrics import dice
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.maps import Reader

LEVEL, DRAWS = 0.5, 2000
ONE_WIRE = FluoroscopySettings(no_wire=0.0, two_devices=0.0, field=0.0, catheter=0.0)
RANDOM = {"random, no clutter": replace(ONE_WIRE, clutter=1e-6, contrast=0.0), "random": ONE_WIRE}
Image = NDArray[np.uint8]
Items = Iterator[tuple[Image, NDArray[np.float64]]]
Marks = Callable[[Image], NDArray[np.bool_]]


def of_data_set(data: Dataset, count: int, fluoroscopy: RandomFluoroscopy | None) -> Items:
    """Images of the test part with their lines; as taken, or drawn along the same lines."""
    for item in images_of(data, split(data).test, count).tolist():
        camera, index = divmod(item, len(data.frames))
        frame = data.frames[index]
        line = frame.polyline(VIEWS[camera])
        if fluoroscopy is None:
            yield frame.image(VIEWS[camera]), line
            continue
        side, scale = data.side_px, fluoroscopy.settings.image_px / data.side_px
        image = fluoroscopy.along(item, [(line + 0.5) * scale - 0.5]).image
        yield cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA), line


def of_real(folder: Path, curves: Path) -> Items:
    """Real images that can be read, with their annotated lines."""
    images, _ = annotated_images(folder, json.loads(curves.read_text()), curves)
    for one in images:
        if one.image is not None:
            yield np.asarray(one.image, np.uint8), one.curve


def marks_of(network: SegmentationPredictor) -> Marks:
    """The mask of a segmentation network, at the image's size."""
    side = network.preprocessing.source_px

    def marks(image: Image) -> NDArray[np.bool_]:
        seen = image if image.shape == (side, side) else cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
        mask = network.predict(seen)
        height, width = image.shape
        return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) > 0)

    return marks


def figures(marks: Marks, items: Items) -> tuple[dict[str, object], float]:
    """Figures of one kind of images, and the processor seconds of an image."""
    rows, spent = [], 0.0
    for image, line in items:
        began = time.process_time()
        mask = marks(image)
        spent += time.process_time() - began
        true = drawn(image.shape, line)
        away = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, 5) > NEAR_PX
        to_mask = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        places = np.rint(resample(line, spacing=1.0)).astype(int)
        inside = ((places >= 0) & (places < image.shape[::-1])).all(axis=1)
        column, row = places[inside].T
        rows.append((dice(mask, true), float((to_mask[row, column] <= NEAR_PX).mean()), float((mask & away).sum())))
    table = np.array(rows)
    chosen = np.random.default_rng(0).integers(len(table), size=(DRAWS, len(table)))
    interval = np.quantile(table[:, 0][chosen].mean(axis=1), [0.025, 0.975])
    mean = dict(zip(("dice", "recall", "false_px"), table.mean(axis=0).round(3).tolist(), strict=True))
    return {**mean, "dice_interval": interval.round(3).tolist(), "images": len(table)}, spent / len(table)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("networks", type=Path, nargs="*", help="files of segmentation networks")
    parser.add_argument("--images", type=int, default=60, help="of the data set's test part")
    parser.add_argument("--real", type=Path, nargs=2, metavar=("FOLDER", "CURVES"), help="real images and their curves")
    parser.add_argument("--seed", type=int, default=3_000_003, help="of random fluoroscopy")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    data = Dataset.open(given.data)
    reader = Reader.pretrained()
    rows: dict[str, Marks] = {"reader": lambda image: reader.maps(image).wire >= LEVEL}
    rows |= {str(path): marks_of(SegmentationPredictor.load(path)) for path in given.networks}
    for name, marks in rows.items():
        kinds = {"as taken": of_data_set(data, given.images, None)}
        for kind, settings in RANDOM.items():
            kinds[kind] = of_data_set(data, given.images, RandomFluoroscopy(settings, given.seed))
        if given.real is not None:
            kinds["real"] = of_real(*given.real)
        measured = {kind: figures(marks, items) for kind, items in kinds.items()}
        told = {kind: row for kind, (row, _) in measured.items()}
        print(json.dumps({"network": name, **told, "ms_an_image": round(1e3 * measured["as taken"][1], 1)}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
