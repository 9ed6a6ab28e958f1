"""Tables of the stage guide3d: what the data set holds, reprojection, and reconstructions against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from guide3d.dataset.dataset import Dataset
from guide3d.reconstruction.evaluation import (
    METRICS,
    Record,
    accepted,
    mean_and_spread,
    profile_summary,
    reprojection_summary,
    truth_summary,
)
from pipeline.stages.guide3d.reconstruction import WAYS

_WIRES = {"angled": "radifocus_angled", "straight": "nitrex_straight"}


def composition_table(data: Dataset) -> dict[str, Any]:
    """Images by wire and fluid, as the thesis counts them: both cameras together."""
    rows: dict[str, Any] = {}
    for wire, row in (*_WIRES.items(), (None, "total")):
        frames = [frame for frame in data.frames if wire in (None, frame.wire)]
        fluid = sum(frame.fluid for frame in frames)
        rows[row] = {"with_fluid": 2 * fluid, "without_fluid": 2 * (len(frames) - fluid), "total": 2 * len(frames)}
    return rows


def comparison_row(data: Dataset, *, simulated: bool) -> dict[str, Any]:
    """The data set's row of the table that compares it with others'; `simulated`: whether it was generated here."""
    cells: dict[str, Any] = {"collection": "biplane X-ray", "type": "video", "frames": 2 * len(data.frames)}
    if simulated:
        cells |= {"source": "simulated phantom", "annotation": "automatic", "public": "generated from a seed"}
    return {"both/guide3d": cells}


def reconstruction_tables(records: Sequence[Record]) -> dict[str, Any]:
    """Reprojection along the wire, the ways beside each other, and the simulated validation where there is truth.

    Returns:
        Table to row to column to cell.
    """
    by_way = {way: [record for record in records if record["way"] == way] for way in WAYS}
    tables: dict[str, Any] = {
        "guide3d_reconstruction": {way: reprojection_summary(own) for way, own in by_way.items() if own}
    }
    kept = {way: accepted(own) for way, own in by_way.items()}
    ours = kept[WAYS[0]]
    if ours:
        tables["guide3d_reprojection_px"] = {
            f"camera_{view}": profile_summary([record[f"along_{view}_px"] for record in ours]) for view in ("a", "b")
        }
    if any("mers" in record for record in ours):
        tables["guide3d_simulated_validation_mm"] = {
            metric: {"value": mean_and_spread([record[metric] for record in ours]), "n": len(ours)}
            for metric in METRICS[:3]
        }
        tables["guide3d_simulated_ways_mm"] = {way: truth_summary(own) for way, own in kept.items() if own}
    return tables
