"""Evaluation of reconstructions: the errors of single pairs in the images and in space, and their summaries.

A record holds a pair's figures as plain numbers and lists, so that it can be written as JSON. Of a pair that could not
be reconstructed it holds `accepted` (False) and `reason` only.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from guide3d.geometry.camera import Camera
from guide3d.geometry.metrics import curve_metrics, distances_along
from guide3d.geometry.polyline import Array, arc_length
from guide3d.reconstruction.reconstruction import reconstruct, reconstruct_greedy

Record = dict[str, Any]

PLACES = 30  # along the wire at which errors are given, from the tip to its end
METRICS = ("max_ed", "mete", "mers", "frechet", "chamfer")


def evaluate_pair(
    camera_a: Camera, camera_b: Camera, a: ArrayLike, b: ArrayLike, truth_mm: Array | None = None, *, greedy: bool
) -> Record:
    """Reconstructs one pair and measures the result.

    Args:
        a, b: (n, 2) and (m, 2) undistorted px annotated in A and B, tip first.
        truth_mm: (k, 3) the true wire, where it is known.
        greedy: by `reconstruct_greedy` instead of `reconstruct`.

    Returns:
        The record: `accepted`, `reason`, `cpu_s`, mean reprojection (px), coverage, residuals at `PLACES` places along
        the wire (px), length and standard deviation (mm), the fitted curve as ``curve``; with the truth the five curve
        metrics, the distances along the wire and the error of the length (mm).
    """
    started = time.process_time()
    try:
        curve = (reconstruct_greedy if greedy else reconstruct)(camera_a, camera_b, a, b)
    except ValueError as error:
        return {"accepted": False, "reason": str(error)}
    record: Record = {
        "cpu_s": time.process_time() - started,
        "accepted": bool(curve.accepted),
        "reason": "; ".join(curve.warnings),
        "mean_a_px": float(curve.mean_a_px),
        "mean_b_px": float(curve.mean_b_px),
        "coverage": float(curve.coverage),
        "tangent_share": max(curve.tangent_share),
        "along_a_px": _at_places(curve.residual_a_px),
        "along_b_px": _at_places(curve.residual_b_px),
        "length_mm": curve.length_mm,
        "sd_mm": float(curve.sd_mm.mean()),
        "curve": curve.spline.to_tck(),
    }
    if truth_mm is not None:
        record |= curve_metrics(truth_mm, curve.curve_mm)
        record["along_mm"] = _at_places(distances_along(truth_mm, curve.curve_mm))
        record["length_error_mm"] = record["length_mm"] - float(arc_length(truth_mm)[-1])
    return record


def accepted(records: Sequence[Record]) -> list[Record]:
    """Returns the records of reconstructions that were not rejected."""
    return [record for record in records if record["accepted"]]


def reprojection_summary(records: Sequence[Record]) -> dict[str, Any]:
    """Sums up reprojection (px), coverage, share of accepted pairs (both %) and speed over records."""
    done = [record for record in records if "cpu_s" in record]
    if not done:
        return {"accepted_pct": 0.0, "n": len(records)}
    return {
        "mean_a": mean_and_spread([record["mean_a_px"] for record in done]),
        "mean_b": mean_and_spread([record["mean_b_px"] for record in done]),
        "coverage_pct": mean_and_spread([100 * record["coverage"] for record in done]),
        "tangent_pct": mean_and_spread([100 * record["tangent_share"] for record in done]),
        "accepted_pct": 100 * len(accepted(records)) / len(records),
        "pairs_per_s": len(done) / max(sum(record["cpu_s"] for record in done), 1e-9),
        "n": len(records),
    }


def profile_summary(errors: ArrayLike) -> dict[str, Any]:
    """Sums up errors (pairs, places) along wires in the thesis's figures: mean at tip and peak, spread at both ends."""
    values = np.asarray(errors, dtype=float)
    mean, spread = values.mean(axis=0), values.std(axis=0)
    return {
        "distal_mean": float(mean[0]),
        "peak_mean": float(mean.max()),
        "std_start": float(spread[0]),
        "std_end": float(spread[-1]),
        "n": len(values),
    }


def truth_summary(records: Sequence[Record]) -> dict[str, Any]:
    """Sums up the curve metrics and the error of the length (mm) over records of pairs whose truth is known."""
    cells: dict[str, Any] = {metric: mean_and_spread([record[metric] for record in records]) for metric in METRICS}
    cells["length_error"] = mean_and_spread([record["length_error_mm"] for record in records])
    return {**cells, "n": len(records)}


def mean_and_spread(values: Sequence[float]) -> list[float]:
    """Returns mean and standard deviation."""
    return [float(np.mean(values)), float(np.std(values))]


def _at_places(values: Array) -> list[float]:
    return np.interp(np.linspace(0.0, 1.0, PLACES), np.linspace(0.0, 1.0, len(values)), values).tolist()
