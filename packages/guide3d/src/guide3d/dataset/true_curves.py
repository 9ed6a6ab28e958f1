"""Simulated wires in space: truth.json, which stands beside the public layout's files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from guide3d.files import read_json, whole_file
from guide3d.geometry.polyline import Array, checked

VIEWS = ("a", "b")


@dataclass(frozen=True, eq=False)
class TrueCurve:
    """A simulated wire.

    Attributes:
        points_mm: (n, 3) world, tip first, up to where the wire has left both images.
        visible_mm: arc length from the tip to where the wire first leaves the image, of camera "a" and "b".
    """

    points_mm: Array
    visible_mm: tuple[float, float]


def read_truth(path: Path, damaged: list[str]) -> dict[tuple[str, int], TrueCurve]:
    """Reads truth.json: (acquisition, frame number) to the wire.

    Args:
        damaged: takes a sentence for every entry that is left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is something else.
    """
    content = read_json(path, "file of true curves")
    if not isinstance(content, Mapping) or content.get("unit") != "mm" or not isinstance(content.get("frames"), list):
        raise ValueError(f'{path}: expected an object with "unit": "mm" and a list "frames"')
    curves = {}
    for place, entry in enumerate(content["frames"]):
        try:
            points = checked(entry["points"], 3, "true curve")
            a, b = (float(entry["visible_mm"][view]) for view in VIEWS)
            curves[str(entry["acquisition"]), int(entry["frame_number"])] = TrueCurve(points, (a, b))
        except KeyError as error:
            damaged.append(f"{path.name}, entry {place}: {error} is missing")
        except (TypeError, ValueError, OverflowError) as error:
            damaged.append(f"{path.name}, entry {place}: {error}")
    return curves


def write_truth(path: Path, curves: Mapping[tuple[str, int], TrueCurve]) -> None:
    """Writes truth.json, whole or not at all, of (acquisition, frame number) to the wire."""
    frames = [
        {
            "acquisition": acquisition,
            "frame_number": number,
            "visible_mm": {view: round(float(end), 4) for view, end in zip(VIEWS, curve.visible_mm, strict=True)},
            "points": np.round(curve.points_mm, 4).tolist(),
        }
        for (acquisition, number), curve in curves.items()
    ]
    with whole_file(path, "w") as file:
        json.dump({"unit": "mm", "frames": frames}, file, separators=(",", ":"), allow_nan=False)
        file.write("\n")
