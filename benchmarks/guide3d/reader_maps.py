"""Maps of a reader on random images, clean and cluttered, the time of an image, and how fast tiles are drawn.

    python benchmarks/guide3d/reader_maps.py [READER.pt] [--images 24] [--seed 1000003]

Without a file, the shipped reader is measured. Times are processor seconds of one thread. Prints a table, and one JSON
object last.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import torch

from guide3d.learning.reader.evaluation import evaluate_reader
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.maps import Reader
from guide3d.train_reader import VALIDATION_SEED

TILES = 200
EVERY = FluoroscopySettings()
# wires as a phantom's images show them: none faint, little noise
CLEAR = replace(EVERY, weakest=0.78, narrowest_px=2.5, noise=2.0, no_wire=0.0, catheter=0.0, anatomy=0.0)
SETS = {
    "all": EVERY,
    "phantom": CLEAR,
    "phantom, no clutter": replace(CLEAR, clutter=1e-6, contrast=0.0),
    "body": replace(EVERY, anatomy=1.0),
    "no wire": replace(EVERY, no_wire=1.0),
}


def seconds(work, count: int) -> float:
    """Processor seconds that one of `count` calls takes."""
    began = time.process_time()
    for index in range(count):
        work(index)
    return (time.process_time() - began) / count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reader", nargs="?", type=Path, help="file of a reader; none: the shipped one")
    parser.add_argument("--images", type=int, default=24)
    parser.add_argument("--seed", type=int, default=VALIDATION_SEED)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    reader = Reader.pretrained() if given.reader is None else Reader.load(given.reader)
    measured: dict[str, object] = {"seed": given.seed}
    for name, settings in SETS.items():
        scores = asdict(evaluate_reader(reader, RandomFluoroscopy(settings, given.seed), range(given.images)))
        measured[name] = {key: round(value, 3) for key, value in scores.items()}
        print(f"{name:22}", *(f"{key} {value:.3f}" for key, value in scores.items()))
    fluoroscopy = RandomFluoroscopy(seed=given.seed)
    measured["tiles_a_second"] = round(1 / seconds(lambda index: fluoroscopy.tile(index, 256), TILES), 1)
    image = np.random.default_rng(0).integers(0, 255, (1024, 1024), np.uint8)
    reader.maps(image)
    measured["ms_an_image"] = round(1e3 * seconds(lambda _: reader.maps(image), 5), 1)
    print(json.dumps(measured))
    return 0


if __name__ == "__main__":
    sys.exit(main())
