"""Curves read in random fluoroscopy: how much of the wire is found, in which order, and what confidence is worth.

    python benchmarks/guide3d/curve_reading.py --images 40

Whole random images that no training and no choice used (seed and first index as arguments). A wire that is hidden by
the rim of the field counts by its visible parts; of several wires the one that the curve fits best counts. Prints one
line of JSON: shares with 95 % intervals of a bootstrap over images; times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from guide3d.geometry.polyline import Array, arc_length, at_length, distances_to, resample
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.reading.image_reading import ImageReading, read, shipped_reader
from guide3d.reading.maps import Reader

NEAR_PX = 4.0
SHORTEST_PX = 20.0
CONFIDENCES = (0.0, 0.25, 0.5, 0.75, 1.0001)
DRAWS = 2000


def order_error(points: Array, truth: Array) -> float:
    """Mean distance px at equal shares of both lengths."""
    share = np.linspace(0.0, 1.0, 100)
    apart = at_length(points, share * arc_length(points)[-1]) - at_length(truth, share * arc_length(truth)[-1])
    return float(np.hypot(*apart.T).mean())


def image_row(image: RandomImage, reading: ImageReading) -> dict[str, Any]:
    """Figures of one image; None where they have no meaning."""
    wires = [np.concatenate(parts) for parts in image.wires if parts]
    wires = [wire for wire in wires if arc_length(wire)[-1] >= SHORTEST_PX]
    row: dict[str, Any] = {
        "wires": len(wires),
        "found": reading.found,
        "score": _score(reading),
        "messages": reading.messages,
    }
    if not wires or not reading.found:
        return row | {"recall": 0.0 if wires else None, "precision": None, "order_px": None, "tip_px": None}
    wire = min(wires, key=lambda points: order_error(reading.points_px, points))
    off = distances_to(wire, reading.points_px)
    return row | {
        "recall": float((distances_to(reading.points_px, resample(wire, spacing=1.0)) <= NEAR_PX).mean()),
        "precision": float((off <= NEAR_PX).mean()),
        "order_px": order_error(reading.points_px, wire),
        "tip_px": float(np.hypot(*(reading.points_px[0] - wire[0]))),
        "confidence": reading.confidence,
        "near": off <= NEAR_PX,
    }


def _score(reading: ImageReading) -> float | None:
    return round(float(reading.candidates[0].score), 1) if reading.found else None


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Sums up rows of images."""
    with_wire = [row for row in rows if row["wires"]]
    found = [row for row in with_wire if row["found"]]
    empty = [row for row in rows if not row["wires"]]
    total: dict[str, Any] = {
        "images": len(rows),
        "with_wire": len(with_wire),
        "missed": len(with_wire) - len(found),
        "false_wires": f"{sum(row['found'] for row in empty)} of {len(empty)}",
        "recall": interval([row["recall"] for row in with_wire]),
        "precision": interval([row["precision"] for row in found]),
        "in_order": interval([row["order_px"] <= 10.0 if row["found"] else False for row in with_wire]),
        "order_median_px": round(float(np.median([row["order_px"] for row in found])), 2),
        "tip_median_px": round(float(np.median([row["tip_px"] for row in found])), 2),
        "tip_within_10px": interval([row["tip_px"] <= 10.0 if row["found"] else False for row in with_wire]),
        "ms_an_image": round(float(np.mean([row["ms"] for row in rows])), 1),
    }
    confidence = np.concatenate([row["confidence"] for row in found])
    near = np.concatenate([row["near"] for row in found])
    for low, high in itertools.pairwise(CONFIDENCES):
        chosen = (confidence >= low) & (confidence < high)
        share = round(float(near[chosen].mean()), 3) if chosen.any() else None
        total[f"near_where_confidence_{low:g}_to_{min(high, 1.0):g}"] = share
    return total


def interval(values: list[Any]) -> list[float]:
    """Mean and its 95 % interval by bootstrap."""
    numbers = np.asarray(values, float)
    drawn = numbers[np.random.default_rng(0).integers(0, len(numbers), (DRAWS, len(numbers)))].mean(axis=1)
    return [round(float(value), 3) for value in (numbers.mean(), *np.quantile(drawn, (0.025, 0.975)))]


def main() -> int:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reader", type=Path, help="file of a trained reader; the shipped one if left out")
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--first", type=int, default=1000, help="index of the first image")
    parser.add_argument("--seed", type=int, default=1000003)
    parser.add_argument("--rows", action="store_true", help="print a line for every image, too (stderr)")
    arguments = parser.parse_args()
    drawn = RandomFluoroscopy(seed=arguments.seed)
    reader = Reader.load(arguments.reader) if arguments.reader else shipped_reader()
    rows = []
    for index in range(arguments.first, arguments.first + arguments.images):
        image = drawn.image(index)
        if index == arguments.first:
            read(image.image, reader)  # loads and warms up
        started = time.process_time()
        reading = read(image.image, reader)
        spent = 1e3 * (time.process_time() - started)
        rows.append(image_row(image, reading) | {"ms": spent})
        if arguments.rows:
            shown = {key: value for key, value in rows[-1].items() if key not in ("confidence", "near")}
            print(json.dumps({"index": index, **shown}), file=sys.stderr)
    print(json.dumps(summary(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
