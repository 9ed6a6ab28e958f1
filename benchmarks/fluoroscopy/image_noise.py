"""Noise of X-ray images by their size: real ones made smaller, and simulated ones drawn as small.

    python -m benchmarks.fluoroscopy.image_noise REAL [--sizes 1024,512,256,192,96]

REAL is a folder of real images, ``*_a.png`` and ``*_b.png``, whose cameras and background stand still. A real image of
a smaller size is the mean over squares of its pixels. Noise is what two images differ by, over the square root of two:
the standard deviation of their difference, slow differences and what is beyond four of it (a wire) taken out; the
median over all pairs of images. Only pixels brighter than 40 count. Simulated are the same pair of cameras over a
water bath with `type_1` and no wire.
Prints a line a camera and, last, one JSON object: camera to size to real and simulated noise, grey levels.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import load_phantom
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.opencv import cv2

DARK = 40  # grey levels
SLOW = 32  # parts of the side, of which one is the spread of what is taken out
SIMULATED = 4  # images
BEYOND, ROUNDS = 4.0, 6  # standard deviations of what is no noise; times that it is looked for
CAMERAS = ("a", "b")
NO_WIRE = np.empty((0, 3))


def noise_of(images: Sequence[NDArray[np.float32]]) -> float:
    """Standard deviation of an image's noise, grey levels: the median over pairs of images of the same scene."""
    found = []
    for one, other in itertools.combinations(images, 2):
        difference = one - other
        difference = difference - cv2.GaussianBlur(difference, (0, 0), difference.shape[0] / SLOW)
        seen = difference[(one + other) / 2 > DARK]
        for _ in range(ROUNDS):
            seen = seen[np.abs(seen - seen.mean()) < BEYOND * seen.std()]
        found.append(float(seen.std()) / np.sqrt(2))
    return float(np.median(found))


def real(folder: Path, camera: str, size: int) -> list[NDArray[np.float32]]:
    """The real images of a camera, (size, size) each."""
    files = sorted(folder.glob(f"*_{camera}.png"))
    if len(files) < 2:
        raise SystemExit(f"{folder} has {len(files)} images *_{camera}.png: give a folder with two or more")
    images = [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), np.float32) for file in files]
    return [np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA)) for image in images]


def simulated(size: int) -> dict[str, list[NDArray[np.float32]]]:
    """Images of both cameras, (size, size) each."""
    fluoroscope = BiplaneFluoroscope.of(load_phantom("type_1"), "guide3d", size=size)
    frames = [fluoroscope.render(NO_WIRE, seed) for seed in range(SIMULATED)]
    return {camera: [frame[camera].image.astype(np.float32) for frame in frames] for camera in CAMERAS}


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="REAL")
    parser.add_argument("--sizes", default="1024,512,256,192,96", help="px, commas between them")
    given = parser.parse_args()
    table: dict[str, dict[int, dict[str, float]]] = {camera: {} for camera in CAMERAS}
    for size in (int(text) for text in given.sizes.split(",")):
        drawn = simulated(size)
        for camera in CAMERAS:
            row = {"real": noise_of(real(given.folder, camera, size)), "simulated": noise_of(drawn[camera])}
            table[camera][size] = {name: round(value, 2) for name, value in row.items()}
            print(f"{camera} {size:5d} px  real {row['real']:.2f}  simulated {row['simulated']:.2f}", flush=True)
    print(json.dumps(table))


if __name__ == "__main__":
    main()
