"""Calibration on disk: every camera's matrices as JSON in metres, and in the text layout of X-ray laboratories."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.fluoroscopy.c_arms import XRayCamera

Array = NDArray[np.float64]

TEXT_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}  # world units per metre
_HEADINGS = ("image size", "camera matrix", "rotation", "translation")


@dataclass(frozen=True, eq=False)
class Projection:
    """A pinhole camera as a text file holds it."""

    K: Array  # (3, 3) camera to pixel, px
    R: Array  # (3, 3) world to camera
    t: Array  # (3,) the world's origin in the camera frame, in the file's unit
    width: int  # px
    height: int  # px

    @property
    def P(self) -> Array:
        """(3, 4) from homogeneous world points, in the file's unit, to homogeneous pixels."""
        return self.K @ np.column_stack([self.R, self.t])


def write_calibration(cameras: Mapping[str, XRayCamera], folder: Path, *, unit: str = "cm") -> list[Path]:
    """Writes `calibration.json` (SI, with the distortion) and a `projection_<name>.txt` for every camera.

    Args:
        cameras: by name, e.g. those of a `BiplaneFluoroscope`.
        folder: is made where it is missing.
        unit: of the world in the text files, "cm" as laboratories write them, "mm" or "m".

    Returns:
        The files, JSON first.

    Raises:
        ValueError: for an unknown unit.
    """
    if unit not in TEXT_UNITS:
        raise ValueError(f"unknown unit {unit!r}: expected one of {', '.join(TEXT_UNITS)}.")
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "calibration.json"]
    content = {"unit": "m", "cameras": {name: camera.to_json() for name, camera in cameras.items()}}
    written[0].write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    for name, camera in cameras.items():
        projector = camera.projector
        sections: tuple[Array, ...] = (
            np.array([[projector.width, projector.height]]),
            projector.K,
            projector.R,
            projector.t[:, None] * TEXT_UNITS[unit],
        )
        blocks = (
            "\r\n".join([heading, *(",".join(f"{value:.12g}" for value in row) for row in rows)]) + "\r\n"
            for heading, rows in zip(_HEADINGS, sections, strict=True)
        )
        path = folder / f"projection_{name}.txt"
        path.write_bytes("\r\n".join(blocks).encode("ascii"))
        written.append(path)
    return written


def read_projection(path: Path) -> Projection:
    """Reads a camera from the text layout, with commas or semicolons, in the file's own unit.

    Raises:
        ValueError: the file has another layout; the message says which part is wrong.
    """
    blocks: dict[str, list[list[float]]] = {}
    heading = ""
    content = path.read_text(encoding="utf-8-sig")
    if ";" in content:  # as spreadsheets write it where the decimal point is a comma
        content = content.replace(",", ".").replace(";", ",")
    for line in content.split("\n"):
        text = line.strip().rstrip(",")
        if text in _HEADINGS:
            heading, blocks[text] = text, []
        elif text:
            try:
                blocks[heading].append([float(value) for value in text.split(",")])
            except (KeyError, ValueError):
                raise ValueError(f"{path.name} is no projection file: cannot read the line {text!r}.") from None
    shapes = dict(zip(_HEADINGS, ((1, 2), (3, 3), (3, 3), (3, 1)), strict=True))
    arrays = {}
    for name, shape in shapes.items():
        rows = blocks.get(name, [])
        if (len(rows), *{len(row) for row in rows}) != shape:
            raise ValueError(f"{path.name} must hold {shape[0]} x {shape[1]} numbers under '{name}', got {rows}.")
        arrays[name] = np.array(rows)
    width, height = arrays["image size"][0].astype(int).tolist()
    return Projection(arrays["camera matrix"], arrays["rotation"], arrays["translation"].ravel(), width, height)
