"""Real X-ray images: how well the wire in them is read, against annotated curves, in the image and in space.

    python benchmarks/guide3d/real_xray.py FOLDER CURVES --cameras DIR [--reader FILE] [--overlays FOLDER]

FOLDER holds the images. CURVES is a JSON file of either kind, points tip first, px of the images as recorded:

    {"pairs": [{"pair": 2, "camera_a": [[x, y], ...], "camera_b": [...]}]}     images pair02_a.png and pair02_b.png
    {"images": [{"file": "name.png", "curve": [[x, y], ...]}]}                 no cameras

DIR holds the cameras' files (of several sets the one that CURVES names, or that fits best) and may hold X-rays of
perforated sheets: then annotations that turn out to be raw are undistorted, and so are the curves read.

Prints one line of JSON; what cannot be measured is null. Means are over images, with 95 % intervals of a bootstrap over
images. An image that is missing, cannot be read, or in which nothing is found counts: its Dice and shares are 0, its
distances the image's diagonal; a pair without a result counts 100 mm. Times are processor time of one thread.

    dice                       of the curve read, drawn 6 px wide, and the annotation drawn 6 px wide
    recall, precision          share of the annotation within 4 px of the curve, and of the curve within 4 px of it
    within_4px_pct, worst_...  recall in percent: mean, and of the worst image
    curve_median_px, _mean_px  distance of the annotation's points from the curve: median and mean over images of means
    order_mean_px              distance at equal shares of both lengths: large where the order is wrong
    tip_median_px, _mean_px    distance of the first points
    map_dice, _recall, ...     the same of the network's map (probability of 0.5), its skeleton for recall and precision
    pair_mean_mm               mean nearest distance (both ways) of the curve in space from that of the annotation, up
                               to the length of the shorter one: annotations end before the border of the image
    pair_whole_mm              the same of both curves in full
    pair_tip_median_mm         distance of the tips in space
    ms_an_image, ms_a_pair     time from pixels to curve; to the curve in space
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from skimage.morphology import skeletonize

from guide3d.calibration.folder import Rig, distortions_of, rigs_in
from guide3d.geometry.metrics import chamfer, mete
from guide3d.geometry.polyline import Array, arc_length, at_length, checked, distances_to, resample
from guide3d.image_file import read_grey_levels, write_png
from guide3d.opencv import cv2
from guide3d.reading.image_reading import ImageReading, MapReader, read, shipped_reader
from guide3d.reading.output.overlay import draw_reading
from guide3d.reading.pair_reading import combine
from guide3d.reconstruction.reconstruction import reconstruct
from guide3d.reconstruction.view_checks import epipolar_residuals, undistorted_or_raw

WIDTH_PX = 6
NEAR_PX = 4.0
FAILED_MM = 100.0
MAP_LEVEL = 0.5
DRAWS = 2000
IN_IMAGE = ("dice", "recall", "precision", "within_4px_pct", "curve_mean_px", "order_mean_px", "tip_mean_px")
OF_MAP = ("map_dice", "map_recall", "map_precision")


@dataclass(frozen=True, eq=False)
class Annotated:
    """An image and its curve, (n, 2) px, tip first; the image is None where it cannot be read."""

    name: str
    image: NDArray[np.generic] | None
    curve: Array


def annotated_images(folder: Path, content: Any, path: Path) -> tuple[list[Annotated], list[tuple[str, int, int]]]:
    """Reads the images of a file of curves; pairs are (name, number of image a, number of image b)."""
    images: list[Annotated] = []
    pairs: list[tuple[str, int, int]] = []
    if isinstance(content, dict) and isinstance(content.get("images"), list):
        for entry in content["images"]:
            images.append(_annotated(folder / str(entry["file"]), entry["curve"]))
    elif isinstance(content, dict) and isinstance(content.get("pairs"), list):
        for entry in content["pairs"]:
            name = f"pair{int(entry['pair']):02d}"
            for view in "ab":
                images.append(_annotated(folder / f"{name}_{view}.png", entry[f"camera_{view}"]))
            pairs.append((name, len(images) - 2, len(images) - 1))
    if not images:
        raise ValueError(f'{path}: expected {{"pairs": [...]}} or {{"images": [...]}} with at least one curve')
    return images, pairs


def _annotated(file: Path, points: Any) -> Annotated:
    curve = checked(points, 2, f"curve of {file.name}")
    try:
        return Annotated(file.name, read_grey_levels(file), curve)
    except ValueError as error:
        print(error, file=sys.stderr)
        return Annotated(file.name, None, curve)


def drawn(shape: tuple[int, ...], points: Array) -> NDArray[np.bool_]:
    """Draws a curve 6 px wide."""
    canvas = np.zeros(shape[:2], np.uint8)
    cv2.polylines(canvas, [np.rint(points * 16).astype(np.int32)], False, 1, WIDTH_PX, cv2.LINE_8, 4)
    return np.asarray(canvas > 0)


def dice(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Dice coefficient of two masks."""
    return float(2.0 * (a & b).sum() / max(int(a.sum() + b.sum()), 1))


def image_figures(item: Annotated, reading: ImageReading | None) -> dict[str, float]:
    """Figures of one image; without a curve those of a failure."""
    if item.image is None or reading is None or not reading.found:
        size = (1024, 1024) if item.image is None else item.image.shape
        far = float(np.hypot(*size[:2]))
        return dict(zip(IN_IMAGE, (0.0, 0.0, 0.0, 0.0, far, far, far), strict=True))
    truth = resample(item.curve, spacing=1.0)
    found = resample(reading.points_px, spacing=1.0)
    off = distances_to(reading.points_px, truth)
    share = np.linspace(0.0, 1.0, 100)
    apart = at_length(truth, share * arc_length(truth)[-1]) - at_length(found, share * arc_length(found)[-1])
    recall = float((off <= NEAR_PX).mean())
    return {
        "dice": dice(drawn(item.image.shape, found), drawn(item.image.shape, truth)),
        "recall": recall,
        "precision": float((distances_to(item.curve, found) <= NEAR_PX).mean()),
        "within_4px_pct": 100.0 * recall,
        "curve_mean_px": float(off.mean()),
        "order_mean_px": float(np.hypot(*apart.T).mean()),
        "tip_mean_px": float(np.hypot(*(reading.points_px[0] - item.curve[0]))),
    }


def map_figures(item: Annotated, wire: NDArray[np.float32] | None) -> dict[str, float]:
    """Figures of the network's map of one image."""
    if item.image is None or wire is None or wire.shape != item.image.shape:
        return dict.fromkeys(OF_MAP, 0.0)
    mask = wire >= MAP_LEVEL
    truth = resample(item.curve, spacing=1.0)
    lines = skeletonize(mask)
    rows, columns = np.nonzero(lines)
    skeleton = np.stack([columns, rows], axis=1).astype(float)
    near = 0.0
    if len(skeleton):
        away = cv2.distanceTransform((~lines).astype(np.uint8), cv2.DIST_L2, 5)
        near = float((_sampled(away, truth) <= NEAR_PX).mean())
    precise = float((distances_to(item.curve, skeleton) <= NEAR_PX).mean()) if len(skeleton) else 0.0
    return dict(zip(OF_MAP, (dice(mask, drawn(mask.shape, truth)), near, precise), strict=True))


def _sampled(values: NDArray[np.float32], points: Array) -> Array:
    column, row = np.rint(points).astype(int).T
    return np.asarray(
        values[np.clip(row, 0, values.shape[0] - 1), np.clip(column, 0, values.shape[1] - 1)], dtype=float
    )


class KeepsMaps:
    """A reader that keeps the map of wires of the image it read first since it was cleared."""

    def __init__(self, reader: MapReader) -> None:
        self.reader = reader
        self.wire: NDArray[np.float32] | None = None

    def maps(self, image: NDArray[np.uint8]) -> Any:
        """Reads an image."""
        found = self.reader.maps(image)
        if self.wire is None:
            self.wire = found.wire
        return found


def chosen_rig(rigs: list[Rig], said: str, annotations: Sequence[tuple[Array, Array]]) -> Rig:
    """The set of cameras that the curves' file names, or else the one that fits its annotations best."""
    named = [rig for rig in rigs if rig.name in said]
    if len(named) == 1 or len(rigs) == 1:
        return (named or rigs)[0]
    return min(rigs, key=lambda rig: float(np.median(epipolar_residuals(*rig.cameras, annotations))))


def in_common(a: Array, b: Array) -> tuple[Array, Array]:
    """Cuts the longer of two curves, tip first, to the length of the shorter one."""
    length = min(float(arc_length(curve)[-1]) for curve in (a, b))
    along = np.append(np.arange(0.0, length, 0.5), length)
    return at_length(a, along), at_length(b, along)


def pair_figures(
    images: list[Annotated],
    pairs: list[tuple[str, int, int]],
    readings: list[ImageReading | None],
    folder: Path,
    said: str,
) -> dict[str, Any]:
    """Figures in space: curves read against curves annotated, both by the same reconstruction."""
    annotations = [(images[a].curve, images[b].curve) for _, a, b in pairs]
    rig = chosen_rig(rigs_in(folder), said, annotations)
    distortions = distortions_of(folder)
    if distortions is not None:
        undistort = [distortion.undistort_points for distortion in distortions]
        verdict = undistorted_or_raw(*rig.cameras, annotations, *undistort)
        print(verdict.sentence, file=sys.stderr)
        if verdict.answer == "raw":
            annotations = [(undistort[0](a), undistort[1](b)) for a, b in annotations]
        else:
            distortions = None
    rows = []
    for (name, a, b), annotation in zip(pairs, annotations, strict=True):
        row: dict[str, Any] = {
            "pair": name,
            "mean_mm": FAILED_MM,
            "whole_mm": FAILED_MM,
            "tip_mm": FAILED_MM,
            "accepted": False,
            "ms": 0.0,
        }
        try:
            truth = reconstruct(*rig.cameras, *annotation).curve_mm
            views = [readings[a], readings[b]]
            started = time.process_time()
            if any(view is None or not view.found for view in views):
                raise ValueError("nothing was found in one of the images")
            found = combine([view for view in views if view is not None], rig.cameras, distortions)
            row["ms"] = 1e3 * (time.process_time() - started)
            row |= {
                "mean_mm": min(chamfer(*in_common(truth, found.curve_mm)), FAILED_MM),
                "whole_mm": min(chamfer(truth, found.curve_mm), FAILED_MM),
                "tip_mm": min(mete(truth, found.curve_mm), FAILED_MM),
                "accepted": found.accepted,
                "residual_px": found.residual_px,
                "messages": found.messages,
            }
        except ValueError as error:
            row["messages"] = [str(error)]
        rows.append(row)
    return {"cameras": rig.name, "rows": rows}


def interval(values: Sequence[float], middle: Any = np.mean) -> list[float]:
    """95 % interval of a mean or median by bootstrap."""
    rng = np.random.default_rng(0)
    drawn_values = np.asarray(values)[rng.integers(0, len(values), (DRAWS, len(values)))]
    return [round(float(value), 4) for value in np.quantile(middle(drawn_values, axis=1), (0.025, 0.975))]


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Reads all images and sums up."""
    content = json.loads(arguments.curves.read_text(encoding="utf-8"))
    images, pairs = annotated_images(arguments.folder, content, arguments.curves)
    network = KeepsMaps(_reader(arguments.reader))
    readings: list[ImageReading | None] = []
    rows: list[dict[str, Any]] = []
    for number, item in enumerate(images):
        reading, spent, said = None, 0.0, "the image cannot be read"
        network.wire = None
        if item.image is not None:
            try:
                if number == 0:
                    read(item.image, network)  # loads and warms up
                    network.wire = None
                started = time.process_time()
                reading = read(item.image, network)
                spent = 1e3 * (time.process_time() - started)
                said = "; ".join(reading.messages)
            except ValueError as error:
                said = str(error)
        readings.append(reading)
        figures = image_figures(item, reading) | map_figures(item, network.wire)
        rows.append({"file": item.name, **figures, "ms": spent, "messages": said})
        if arguments.overlays is not None and item.image is not None and reading is not None:
            picture = draw_reading(item.image, reading, item.curve)
            write_png(picture, arguments.overlays / f"{Path(item.name).stem}.png")
    total: dict[str, Any] = {"images": len(rows), "missed": sum(row["recall"] == 0.0 for row in rows)}
    for key in (*IN_IMAGE, *OF_MAP):
        total[key] = float(np.mean([row[key] for row in rows]))
    total["worst_within_4px_pct"] = min(row["within_4px_pct"] for row in rows)
    for key in ("curve", "tip"):
        total[f"{key}_median_px"] = float(np.median([row[f"{key}_mean_px"] for row in rows]))
    total["ms_an_image"] = float(np.mean([row["ms"] for row in rows if row["ms"]])) if any(readings) else None
    total |= dict.fromkeys(
        ("pair_mean_mm", "pair_whole_mm", "pair_tip_median_mm", "pair_worst_mm", "pairs_accepted", "ms_a_pair")
    )
    intervals = {key: interval([row[key] for row in rows]) for key in (*IN_IMAGE, *OF_MAP)}
    intervals["tip_median_px"] = interval([row["tip_mean_px"] for row in rows], np.median)
    if pairs and arguments.cameras is not None:
        space = pair_figures(images, pairs, readings, arguments.cameras, json.dumps(content.get("units", "")))
        mean, tip = ([row[key] for row in space["rows"]] for key in ("mean_mm", "tip_mm"))
        total["pair_mean_mm"], total["pair_worst_mm"] = float(np.mean(mean)), max(mean)
        total["pair_whole_mm"] = float(np.mean([row["whole_mm"] for row in space["rows"]]))
        total["pair_tip_median_mm"] = float(np.median(tip))
        total["pairs_accepted"] = sum(row["accepted"] for row in space["rows"])
        took = [2.0 * (total["ms_an_image"] or 0.0) + row["ms"] for row in space["rows"]]
        total["ms_a_pair"] = float(np.mean(took))
        intervals["pair_mean_mm"], intervals["pair_tip_median_mm"] = interval(mean), interval(tip, np.median)
        rows += space["rows"]
    if arguments.rows:
        for row in rows:
            print(json.dumps(_rounded(row)), file=sys.stderr)
    return {**_rounded(total), "intervals": intervals}


def _reader(file: Path | None) -> MapReader:
    if file is None:
        return shipped_reader()
    from guide3d.reading.maps import Reader

    return Reader.load(file)


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in values.items()}


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="real_xray.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of the images")
    parser.add_argument("curves", type=Path, help="JSON file of the annotated curves")
    parser.add_argument("--cameras", type=Path, help="folder of the cameras' files, for figures in space")
    parser.add_argument("--reader", type=Path, help="file of a trained reader; the shipped one if left out")
    parser.add_argument("--overlays", type=Path, help="folder for pictures of the curves on the images")
    parser.add_argument("--rows", action="store_true", help="print a line for every image and pair, too (stderr)")
    arguments = parser.parse_args(words)
    try:
        if not arguments.folder.is_dir():
            raise ValueError(f"{arguments.folder} is missing: expected a folder of images")
        print(json.dumps(measure(arguments)))
    except (KeyError, OSError, TypeError, ValueError) as error:
        what = f"an entry of {arguments.curves} lacks {error}" if isinstance(error, KeyError) else error
        print(f"real_xray.py: {what}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
