"""Curves of SplineFormer and of guide3d's reader in the same X-ray images, random and real.

    python benchmarks/splineformer/xray_curves.py [--real FOLDER CURVES] [--network FILE] [--overlays FOLDER]

Random images are those of seed 1000003 from index 30000 on, on which nothing was chosen: "cluttered" with everything,
"clean" without clutter and contrast medium. Real ones are a folder of images with a JSON file of annotated curves, of
either kind, {"pairs": [...]} or {"images": [...]}. Prints a line of JSON for each set and reader:

    curve_median_px   median over images of the mean distance of the true curve's points from the curve found
    order_median_px   the same at equal shares of both lengths: large where the order is wrong
    tip_median_px     of the first points
    in_order          share of images less than 10 px off in that order
    missed            images with one wire in which none was found
    found_in_empty    images without a wire in which one was found, of `empty`
    ms_an_image       processor time of one thread

Medians are over images in which a wire was found, with 95 % intervals of a bootstrap over these.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from guide3d.geometry.polyline import Array, checked
from guide3d.image_file import read_grey_levels, write_png
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.image_reading import read
from splineformer.comparison.fluoroscopy_figures import (
    TEST_FIRST,
    TEST_SEED,
    CurveFinder,
    curve_figures,
    figures_of,
    finder,
    summary,
)
from splineformer.image_input import pixels_of_shares
from splineformer.learning.fluoroscopy_samples import ONE, curve_of
from splineformer.predictor import Predictor

SETS = {"cluttered": FluoroscopySettings(), "clean": FluoroscopySettings(clutter=1e-6, contrast=0.0)}
DRAWS = 2000


def by_reader(image: Any) -> Array | None:
    """The curve that guide3d reads, (n, 2) px."""
    try:
        reading = read(image)
    except ValueError:
        return None
    return reading.points_px if reading.found else None


def random_images(settings: FluoroscopySettings, first: int, count: int) -> list[tuple[Any, Any, Array | None]]:
    """Name, random image, and the one wire in it, of `count` indices."""
    drawn = RandomFluoroscopy(settings, TEST_SEED)
    images = []
    for index in range(first, first + count):
        image = drawn.image(index)
        wires, curve = curve_of(image)
        size = image.image.shape[::-1]
        images.append((index, image, pixels_of_shares(curve, size) if wires == ONE and curve is not None else None))
    return images


def real_images(folder: Path, curves: Path) -> list[tuple[str, Any, Array]]:
    """Name, image and annotated curve."""
    content = json.loads(curves.read_text(encoding="utf-8"))
    named = [(str(entry["file"]), entry["curve"]) for entry in content.get("images", [])]
    for entry in content.get("pairs", []):
        named += [(f"pair{int(entry['pair']):02d}_{view}.png", entry[f"camera_{view}"]) for view in "ab"]
    return [(name, read_grey_levels(folder / name), checked(curve, 2, name)) for name, curve in named]


def overlay(image: Any, truth: Array | None, found: Array | None) -> Any:
    """The image with the true curve in green and the one found in red, its tip a circle."""
    picture = np.repeat(np.asarray(image, np.uint8)[..., None], 3, 2)
    for points, colour in ((truth, (0, 200, 0)), (found, (255, 40, 40))):
        if points is None:
            continue
        line = np.rint(points * 16).astype(np.int32)
        cv2.polylines(picture, [line], False, colour, 2, cv2.LINE_AA, 4)
        cv2.circle(picture, tuple(int(v) for v in line[0]), 9 * 16, colour, 2, cv2.LINE_AA, 4)
    return picture


def measured(images: list[tuple[Any, Any, Array | None]], find: CurveFinder, folder: Path | None) -> dict[str, Any]:
    """Figures of one reader on one set."""
    rows, spent = [], []
    for name, image, truth in images:
        drawn = hasattr(image, "wires")
        pixels = image.image if drawn else image
        started = time.process_time()
        found = find(pixels)
        spent.append(1e3 * (time.process_time() - started))
        if drawn:
            rows.append(figures_of(image, found))
        else:
            row = {"wires": ONE, "measured": True, "found": found is not None}
            rows.append(row if found is None or truth is None else row | curve_figures(found, truth))
        if folder is not None:
            write_png(overlay(pixels, truth, found), folder / f"{Path(str(name)).stem}.png")
    total = summary(rows) | {"ms_an_image": float(np.median(spent))}
    for key in ("curve", "order", "tip"):
        values = np.array([row[f"{key}_px"] for row in rows if f"{key}_px" in row])
        if len(values):
            resampled = values[np.random.default_rng(0).integers(0, len(values), (DRAWS, len(values)))]
            total[f"{key}_interval_px"] = np.quantile(np.median(resampled, axis=1), (0.025, 0.975)).tolist()
    return total


def rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Numbers with three digits after the point."""
    digits = {key: [round(one, 3) for one in value] for key, value in values.items() if isinstance(value, list)}
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in (values | digits).items()}


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, nargs=2, metavar=("FOLDER", "CURVES"), help="real images and their curves")
    parser.add_argument("--network", type=Path, help="file of a SplineFormer; the shipped one if left out")
    parser.add_argument("--images", type=int, default=100, help="random images of each set; 0: none")
    parser.add_argument("--first", type=int, default=TEST_FIRST, help="index of the first random image")
    parser.add_argument("--overlays", type=Path, help="folder for pictures of SplineFormer's curves")
    parser.add_argument("--alone", action="store_true", help="leave guide3d's reader out")
    given = parser.parse_args(words)
    try:
        predictor = Predictor.pretrained() if given.network is None else Predictor.load(given.network)
        sets: dict[str, Any] = {}
        if given.images:
            sets = {name: random_images(settings, given.first, given.images) for name, settings in SETS.items()}
        if given.real is not None:
            sets["real"] = real_images(*given.real)
    except (OSError, KeyError, ValueError) as error:
        print(f"xray_curves.py: {error}", file=sys.stderr)
        return 1
    finders: dict[str, CurveFinder] = {"splineformer": finder(predictor)}
    if not given.alone:
        finders["reader"] = by_reader
    for name, images in sets.items():
        for who, find in finders.items():
            folder = given.overlays / name if given.overlays is not None and who == "splineformer" else None
            print(json.dumps({"set": name, "by": who, **rounded(measured(images, find, folder))}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
