"""Tables of the stage guide3d: what the data set holds, reprojection, and reconstructions against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from guide3d.dataset.dataset import Dataset
from pipeline.stages.guide3d.reconstruction import PLACES, WAYS, Record

_WIRES = {"angled": "radifocus_angled", "straight": "nitrex_straight"}
_METRICS = ("max_ed", "mete", "mers", "frechet", "chamfer")


def composition_table(data: Dataset) -> dict[str, Any]:
    """Images by wire and fluid, as the thesis counts them: both cameras together."""
    rows: dict[str, Any] = {}
    for wire, row in (*_WIRES.items(), (None, "total")):
        frames = [frame for frame in data.frames if wire in (None, frame.wire)]
        fluid = sum(frame.fluid for frame in frames)
        rows[row] = {
            "with_fluid": 2 * fluid,
            "without_fluid": 2 * (len(frames) - fluid),
            "total": 2 * len(frames),
        }
    return rows


def comparison_row(data: Dataset, *, simulated: bool) -> dict[str, Any]:
    """The data set's row of the table that compares it with others'.

    Args:
        data: the data set.
        simulated: whether it was generated here.
    """
    cells: dict[str, Any] = {"collection": "biplane X-ray", "type": "video", "frames": 2 * len(data.frames)}
    if simulated:
        cells |= {"source": "simulated phantom", "annotation": "automatic", "public": "generated from a seed"}
    return {"both/guide3d": cells}


def reconstruction_tables(records: Sequence[Record]) -> dict[str, Any]:
    """Reprojection along the wire, the ways beside each other, and the simulated validation where there is truth.

    Args:
        records: of all ways.

    Returns:
        Table to row to column to cell.
    """
    by_way = {way: [record for record in records if record["way"] == way] for way in WAYS}
    tables: dict[str, Any] = {"guide3d_reconstruction": {}}
    for way, own in by_way.items():
        if own:
            tables["guide3d_reconstruction"][way] = _reprojection(own)
    ours = accepted(by_way[WAYS[0]])
    if ours:
        tables["guide3d_reprojection_px"] = {
            f"camera_{view}": _along(np.array([record[f"along_{view}_px"] for record in ours]), len(ours))
            for view in ("a", "b")
        }
    if any("mers" in record for record in ours):
        tables["guide3d_simulated_validation_mm"] = {
            metric: {"value": _cell([record[metric] for record in ours]), "n": len(ours)} for metric in _METRICS[:3]
        }
        tables["guide3d_simulated_ways_mm"] = {}
        for way, own in by_way.items():
            kept = accepted(own)
            if kept:
                cells: dict[str, Any] = {metric: _cell([record[metric] for record in kept]) for metric in _METRICS}
                cells["length_error"] = _cell([record["length_error_mm"] for record in kept])
                tables["guide3d_simulated_ways_mm"][way] = {**cells, "n": len(kept)}
    return tables


def accepted(records: Sequence[Record]) -> list[Record]:
    """The reconstructions that were not rejected."""
    return [record for record in records if record["accepted"]]


def _reprojection(records: Sequence[Record]) -> dict[str, Any]:
    done = [record for record in records if "cpu_s" in record]
    if not done:
        return {"accepted_pct": 0.0, "n": len(records)}
    return {
        "mean_a": _cell([record["mean_a_px"] for record in done]),
        "mean_b": _cell([record["mean_b_px"] for record in done]),
        "coverage_pct": _cell([100 * record["coverage"] for record in done]),
        "tangent_pct": _cell([100 * record["tangent_share"] for record in done]),
        "accepted_pct": 100 * len(accepted(records)) / len(records),
        "pairs_per_s": len(done) / max(sum(record["cpu_s"] for record in done), 1e-9),
        "n": len(records),
    }


def _along(errors: np.ndarray, pairs: int) -> dict[str, Any]:
    """The thesis's figures, read off mean and spread at places along the wire."""
    mean, spread = errors.mean(axis=0), errors.std(axis=0)
    assert len(mean) == PLACES
    return {
        "distal_mean": float(mean[0]),
        "peak_mean": float(mean.max()),
        "std_start": float(spread[0]),
        "std_end": float(spread[-1]),
        "n": pairs,
    }


def _cell(values: Sequence[float]) -> list[float]:
    return [float(np.mean(values)), float(np.std(values))]
