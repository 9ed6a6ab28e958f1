"""Centrelines as 3D Slicer writes them: markups of one curve a file, with a radius at each of its points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cathsim.guarded_reading import UnreadableFileError, open_regular

ENDING = ".mrk.json"
_LARGEST = 20_000_000  # bytes of a file
_LPS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0)}

Array = NDArray[np.float64]


class Curve(NamedTuple):
    """A centreline: points (n, 3) and radii (n,), in the file's unit, on axes to the left, posterior and superior."""

    points: Array
    radius: Array


def read_curve(path: Path) -> Curve:
    """Reads the curve of a markups file.

    Raises:
        UnreadableFileError: a ValueError of one sentence: there is no such file, or no curve with radii in it.
    """
    with open_regular(path, _LARGEST) as file:
        content = file.read()
    try:
        markup: dict[str, Any] = json.loads(content)["markups"][0]
        signs = _LPS[markup["coordinateSystem"]]
        points = np.array([one["position"] for one in markup["controlPoints"]], dtype=np.float64)
        radius = next(one["controlPointValues"] for one in markup["measurements"] if one["name"] == "Radius")
        curve = Curve(points * signs, np.array(radius, dtype=np.float64))
        sound = curve.points.shape == (len(curve.radius), 3) and len(curve.radius) > 1
    except (ValueError, KeyError, IndexError, TypeError, StopIteration, RecursionError):
        sound = False
    if not sound or not (np.isfinite(curve.points).all() and np.isfinite(curve.radius).all()):
        raise UnreadableFileError(f"{path.name} holds no curve with a radius at each point; write it again.")
    return curve
