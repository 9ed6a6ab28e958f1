"""Cases of a claim of reconstruction: a drawn wire each, clicked in two views."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pipeline.protocol.claims import Reconstruction
from pipeline.seeds import protocol_arches


def cases(claim: Reconstruction, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: the scene's number and the seed that all are drawn with."""
    for number, scene in enumerate(protocol_arches(claim.first, seed, claim.count)):
        yield {"anatomy": f"scene_{scene}", "number": number, "seed": scene - number}


def play(claim: Reconstruction, case: dict[str, Any]) -> dict[str, Any]:
    """Reconstructs a case's wire.

    Returns:
        `success` (whether there is a curve), `mean_mm` (mean distance at equal arc length from the tips), `max_mm` and
        `tip_mm`.
    """
    from guide3d.geometry.metrics import curve_metrics
    from guide3d.reconstruction.reconstruction import reconstruct
    from guide3d.reconstruction.synthetic_scene import scene

    drawn = scene(case["number"], case["seed"], claim.noise_px)
    try:
        curve = reconstruct(*drawn.cameras, *drawn.points).curve_mm
    except ValueError as error:
        return {"success": False, "reason": str(error)}
    metrics = curve_metrics(curve, drawn.curve_mm)
    return {"success": True} | {
        name: round(float(metrics[key]), 3)
        for name, key in (("mean_mm", "mers"), ("max_mm", "max_ed"), ("tip_mm", "mete"))
    }
