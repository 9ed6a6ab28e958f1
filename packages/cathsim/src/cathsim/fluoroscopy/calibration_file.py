"""Calibration on disk: every camera's matrices as JSON in metres, and in the text layout of X-ray laboratories."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.fluoroscopy.c_arms import XRayCamera

Array = NDArray[np.float64]

TEXT_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}  # world units per metre
_HEADINGS = ("image size", "camera matrix", "rotation", "translation")


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
