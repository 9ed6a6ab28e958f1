"""Tables and figures of the stage guide3d: what the data set holds, reprojection, reconstructions and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import Frame, ImageError
from guide3d.dataset.true_curves import VIEWS
from guide3d.reconstruction.evaluation import (
    METRICS,
    Record,
    accepted,
    mean_and_spread,
    profile_summary,
    reprojection_summary,
    truth_summary,
)
from guide3d.reconstruction.reconstruction import reconstruct, reconstruct_greedy
from pipeline.plots.canvas import draw_in_space
from pipeline.plots.guide3d import Overlay, draw_along, draw_overlays, draw_samples
from pipeline.stages.guide3d.reconstruction import WAYS
from pipeline.tables import Figure

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
    """Reprojection along the wire, the ways beside each other, and the simulated validation where there is truth."""
    by_way = {way: [record for record in records if record["way"] == way] for way in WAYS}
    tables: dict[str, Any] = {
        "guide3d_reconstruction": {way: reprojection_summary(own) for way, own in by_way.items() if own}
    }
    accepted_records = {way: accepted(own) for way, own in by_way.items()}
    ours = accepted_records[WAYS[0]]
    if ours:
        tables["guide3d_reprojection_px"] = {
            f"camera_{view}": profile_summary([record[f"along_{view}_px"] for record in ours]) for view in ("a", "b")
        }
    if any("mers" in record for record in ours):
        tables["guide3d_simulated_validation_mm"] = {
            metric: {"value": mean_and_spread([record[metric] for record in ours]), "n": len(ours)}
            for metric in METRICS[:3]
        }
        tables["guide3d_simulated_ways_mm"] = {way: truth_summary(own) for way, own in accepted_records.items() if own}
    return tables


GROUP = "Guide3D"
_SHOWN = (0.1, 0.5, 0.9, 1.0)  # quantiles of the reprojection error
_BLANK = 230  # grey where a data set has no images


def sample_figure(data: Dataset, folder: Path) -> Figure | None:
    """Draws a pair of images of every kind; None where the data set has no images."""
    columns = []
    for fluid in (True, False):
        for wire in ("angled", "straight"):
            own = [frame for frame in data.frames if (frame.fluid, frame.wire) == (fluid, wire)]
            images = _images(own[len(own) // 2]) if own else None
            if images is not None:
                columns.append((f"{wire} wire, {'with' if fluid else 'without'} fluid", images["a"], images["b"]))
    if not columns:
        return None
    draw_samples(columns, folder / "samples.png")
    acquisitions = len(data.acquisitions)
    return Figure(
        "Images of the data set",
        f"Camera A above, camera B below; {2 * len(data)} images of {acquisitions} acquisitions.",
        "samples.png",
        GROUP,
    )


def reconstruction_figures(data: Dataset, records: Sequence[Record], folder: Path) -> list[Figure]:
    by_way = {way: accepted([record for record in records if record["way"] == way]) for way in WAYS}
    ours, greedy = by_way[WAYS[0]], by_way[WAYS[1]]
    if not ours:
        return []
    errors = {f"camera {view.upper()}": np.array([record[f"along_{view}_px"] for record in ours]) for view in VIEWS}
    draw_along(errors, folder / "reprojection.png")
    by_index = {record["index"]: record for record in ours}
    # where the thesis's way does well, and where it does not: ours hardly tells pairs apart
    chosen = [by_index[record["index"]] for record in _chosen(greedy or ours) if record["index"] in by_index]
    draw_overlays([_overlays(data, record) for record in chosen], folder / "overlays.png")
    draw_in_space([_wires(data, record) for record in chosen], folder / "space.png")
    shares = ", ".join(f"{share:.0%}" for share in _SHOWN)
    return [
        Figure(
            "Reprojection error along the wire",
            f"Mean and standard deviation over {len(ours)} reconstructed pairs, at places equally far apart in space.",
            "reprojection.png",
            GROUP,
        ),
        Figure(
            "Reconstructed wires over their images",
            f"Pairs at {shares} of the greedy way's reprojection error: annotation, and curves in space drawn back. "
            "The figure above each is the global way's.",
            "overlays.png",
            GROUP,
        ),
        Figure(
            "Reconstructed wires in space", "The same pairs from two angles; a dot marks the tip.", "space.png", GROUP
        ),
    ]


def _chosen(records: Sequence[Record]) -> list[Record]:
    ordered = sorted(records, key=lambda record: record["mean_a_px"] + record["mean_b_px"])
    places = dict.fromkeys(round(share * (len(ordered) - 1)) for share in _SHOWN)
    return [ordered[place] for place in places]


def _curves(data: Dataset, record: Record) -> dict[str, np.ndarray]:
    """The pair's wire in space, by way."""
    frame = data.frames[record["index"]]
    assert data.camera_a is not None
    assert data.camera_b is not None
    a, b = (data.undistort(view, frame.polyline(view)) for view in VIEWS)
    curves = {}
    for way, run in zip(WAYS[:2], (reconstruct, reconstruct_greedy), strict=True):
        try:
            curves[way] = run(data.camera_a, data.camera_b, a, b).curve_mm
        except ValueError:
            continue  # the greedy way may find nothing in common
    return curves


def _overlays(data: Dataset, record: Record) -> tuple[Overlay, Overlay]:
    frame, curves = data.frames[record["index"]], _curves(data, record)
    images = _images(frame)
    pair = []
    for view, camera in zip(VIEWS, (data.camera_a, data.camera_b), strict=True):
        assert camera is not None
        blank = np.full((camera.height, camera.width), _BLANK, np.uint8)
        drawn = {way: data.distort(view, camera.project(curve)) for way, curve in curves.items()}
        title = f"{frame.label}, camera {view.upper()}: {record[f'mean_{view}_px']:.2f} px"
        pair.append(Overlay(title, blank if images is None else images[view], frame.polyline(view), drawn))
    return pair[0], pair[1]


def _wires(data: Dataset, record: Record) -> tuple[str, dict[str, np.ndarray]]:
    frame = data.frames[record["index"]]
    curves = _curves(data, record)
    truth = frame.curve_mm
    return frame.label, curves if truth is None else {"truth": truth, **curves}


def _images(frame: Frame) -> dict[str, np.ndarray] | None:
    try:
        return {view: frame.image(view) for view in VIEWS}
    except ImageError:
        return None
