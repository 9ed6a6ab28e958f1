"""Cases of a claim of calibration: a detector each, from X-rays of a perforated sheet and a bead cube, not public."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from pipeline.data.sources import private_data
from pipeline.protocol.claims import Calibration


def cases(claim: Calibration, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: a detector's name; no seed changes them."""
    yield from ({"anatomy": detector} for detector in _figures())


def play(claim: Calibration, case: dict[str, Any]) -> dict[str, Any]:
    """A detector's figures.

    Returns:
        `success`, `leave_out_px` (of the distortion at holes that were left out), and over all poses `beads` and
        `mean_px` of their reprojection.
    """
    figures = _figures()[case["anatomy"]]
    images = figures["images"].values()
    beads = sum(image["beads"] for image in images)
    mean = sum(image["beads"] * image["mean_px"] for image in images) / max(beads, 1)
    return {
        "success": beads > 0,
        "leave_out_px": round(figures["leave_out_px"], 4),
        "beads": beads,
        "mean_px": round(mean, 4),
    }


@lru_cache(maxsize=1)
def _figures() -> Any:
    from guide3d.calibration.__main__ import figures
    from guide3d.calibration.cube_calibration import calibrate_folder

    return figures(calibrate_folder(private_data("xray_calibration")))
