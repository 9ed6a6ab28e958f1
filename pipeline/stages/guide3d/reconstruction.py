"""Reconstruction over a data set: every pair's wire in space, what it misses in the images and of the truth.

Four ways stand beside each other: the global one and the thesis's greedy one, on the annotations as they are and, where
the truth is known, on noisy clicks. The global one on the annotations takes every pair; the others take pairs
spread over the data.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guide3d.dataset.annotation_files import Views, write_curves
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.true_curves import VIEWS, click
from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.polyline import Array
from guide3d.reconstruction.evaluation import Record, evaluate_pair
from guide3d.reconstruction.reconstruction import reconstruct
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import RECONSTRUCTIONS, Source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.atomic_files import read_json, write_text

PARTS, RECORDS = ".parts", "reconstructions.json"  # the former until the stage is done
ON_ANNOTATION, ON_CLICKS = ("global", "greedy"), ("global, clicks", "greedy, clicks")
WAYS = (*ON_ANNOTATION, *ON_CLICKS)


@dataclass(frozen=True)
class ReconstructionJob:
    """Pairs to be reconstructed by one process."""

    folder: Path
    source: Source
    part: int
    frames: tuple[int, ...]
    compared: frozenset[int]  # those of them that all ways take, not only ours
    settings: Guide3dSettings  # with the standard deviation of a click
    seed: int


def reconstruct_pairs(job: ReconstructionJob, report: Report) -> dict[str, Any]:
    """Reconstructs pairs and writes their records and curves; returns how many ``pairs``."""
    data = job.source.open(job.folder)
    entries: list[Record] = []
    with _quiet():
        for place, index in enumerate(job.frames):
            frame = data.frames[index]
            drawn = {view: frame.polyline(view) for view in VIEWS}
            ways = WAYS[:1] if index not in job.compared else ON_ANNOTATION if frame.truth is None else WAYS
            entries += [_entry(data, index, way, drawn) for way in ways if way in ON_ANNOTATION]
            if len(ways) == len(WAYS):
                generator = np.random.default_rng((job.seed, index))
                clicks = {
                    view: click(drawn[view], job.settings.validation_noise_px, min(frame.size_px[view]), generator)
                    for view in VIEWS
                }
                entries += [_entry(data, index, way, clicks) for way in ON_CLICKS]
            report(place / len(job.frames), f"{place} of {len(job.frames)} pairs")
    write_text(part_file(job.folder, job.part), json.dumps(entries))
    return {"pairs": len(job.frames)}


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keeps what single pairs warn of out of the log: the records hold it, and the stage has checked the cameras."""
    logger = logging.getLogger(reconstruct.__module__)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def part_file(folder: Path, part: int) -> Path:
    """Where a job's records lie until they are gathered."""
    return folder / PARTS / f"{part:03d}.json"


def _entry(data: Dataset, index: int, way: str, points: dict[str, Array]) -> Record:
    """Reconstructs one pair in one way."""
    frame, (a, b) = data.frames[index], (data.undistort(view, points[view]) for view in VIEWS)
    assert data.camera_a is not None
    assert data.camera_b is not None
    greedy = way.startswith("greedy")
    record = evaluate_pair(data.camera_a, data.camera_b, a, b, frame.curve_mm, greedy=greedy)
    if way != WAYS[0] or not record["accepted"]:
        record.pop("curve", None)
    return {"index": index, "label": frame.label, "way": way, **record}


def gather(folder: Path, source: Source, parts: Sequence[int]) -> list[Record]:
    """Joins what the jobs left: accepted curves in the public layout, then the records, without curves, in one file."""
    gathered = folder / RECORDS
    if gathered.exists():
        return list(read_json(gathered))
    records: list[Record] = []
    for part in parts:
        records += read_json(part_file(folder, part))
    data = source.open(folder)
    curves: dict[tuple[str, int], Views] = {}
    for record in records:
        if (curve := record.pop("curve", None)) is not None:
            frame = data.frames[record["index"]]
            space = BSplineCurve.from_tck(curve)
            curves[frame.acquisition, frame.number] = Views(frame.spline("a"), frame.spline("b"), space)
    write_curves(folder / RECONSTRUCTIONS, [frame.annotation for frame in data.frames], curves)
    write_text(gathered, json.dumps(records))
    return records
