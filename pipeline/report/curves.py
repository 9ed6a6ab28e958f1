"""Training curves: the `training.csv` that each training leaves, joined over its seeds."""

from __future__ import annotations

import csv
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluations.logs import changed_settings, stage_of

FILE = "training.csv"
_POINTS = 200  # of a joint curve

Array = NDArray[np.float64]

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Curve:
    """How one training went.

    Attributes:
        stage: whose training it was.
        row: what was trained, with whatever else a sweep changed in brackets.
        seed: of the training, as its folder names it.
        columns: name to (n,) values, NaN where a row of the file has none.
    """

    stage: str
    phantom: str
    target: str
    row: str
    seed: str
    columns: dict[str, Array]

    def pairs(self, x: str, y: str) -> tuple[Array, Array]:
        """The (m,) values of two columns where both have one, x rising; empty where a column is missing."""
        nothing = np.zeros(0)
        at, values = (self.columns.get(name, nothing) for name in (x, y))
        if not len(at) or not len(values):
            return nothing, nothing
        there = np.isfinite(at) & np.isfinite(values)
        order = np.argsort(at[there], kind="stable")
        return at[there][order], values[there][order]


@dataclass(frozen=True)
class Band:
    """Mean and spread of a curve over seeds.

    Attributes:
        x: (m,) common positions.
        mean: (m,).
        spread: (m,) standard deviation over the seeds, n - 1 in the denominator; nought with one seed.
    """

    x: Array
    mean: Array
    spread: Array
    seeds: int


def read_curves(folders: Sequence[Path]) -> list[Curve]:
    """Reads the training curves of stage folders, `<phantom>/<target>/<row>/seed<k>/training.csv`.

    Args:
        folders: of the stages, sweep jobs included.

    Returns:
        Those that hold at least one row of numbers; others are named in a warning.
    """
    curves = []
    for folder in folders:
        changed = changed_settings(folder.name)
        for path in sorted(folder.glob(f"*/*/*/seed*/{FILE}")):
            phantom, target, row, seed = path.relative_to(folder).parts[:4]
            columns = read_columns(path)
            if columns:
                name = f"{row} ({changed})" if changed else row
                curves.append(Curve(stage_of(folder.name), phantom, target, name, seed, columns))
            else:
                _LOGGER.warning("left out: %s holds no row of numbers", path)
    return curves


def read_columns(path: Path) -> dict[str, Array]:
    """Reads a CSV file with a head line: column to (n,) values, NaN where a cell is empty.

    A line that is cut off or no numbers, as a killed training may leave it, is skipped.
    """
    rows = []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.reader(stream)
            head = next(reader, [])
            for cells in reader:
                if len(cells) != len(head):
                    continue
                try:
                    rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
                except ValueError:
                    continue
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(head))
    return {name: values[:, index] for index, name in enumerate(head)} if rows else {}


def join_seeds(curves: Sequence[Curve], x: str, y: str) -> Band | None:
    """Mean and spread of column y over x, as far as every seed went: no curve is drawn on beyond its end.

    Returns:
        The band; None where no seed has two points, or they share no stretch.
    """
    points = [pair for pair in (curve.pairs(x, y) for curve in curves) if len(pair[0]) > 1]
    if not points:
        return None
    first, last = max(at[0] for at, _ in points), min(at[-1] for at, _ in points)
    if last <= first:
        return None
    common = np.linspace(first, last, _POINTS)
    values = np.stack([np.interp(common, at, of_seed) for at, of_seed in points])
    spread = values.std(axis=0, ddof=1) if len(points) > 1 else np.zeros(len(common))
    return Band(common, values.mean(axis=0), spread, len(points))
