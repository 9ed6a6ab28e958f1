"""Figures over run seeds: the mean of the seeds' means, and its interval, where a stage ran with several seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.report.intervals import Interval, mean_interval
from pipeline.tables import SAMPLES, Table, mean_of

BOUNDS = ("_low_pct", "_high_pct")  # columns that are bounds of intervals themselves
# ends of names of columns that are shares of something
_SHARES = ("success_pct", "safety_pct", "spl_pct")

CellName = tuple[str, str, str]  # table, row, column


@dataclass(frozen=True)
class OverSeeds:
    """A figure over several seeds, each of which counts alike.

    Attributes:
        cell: mean and standard deviation (n in the denominator) of the seeds' means.
        seeds: how many have the figure.
        is_share: of something, so that it lies between 0 and 100 %.
    """

    cell: list[float]
    seeds: int
    is_share: bool = False

    @property
    def interval(self) -> Interval:
        """Student's 95 % interval of the mean; that of a share is cut off at 0 and 100 %."""
        found = mean_interval(self.cell, self.seeds)
        if found is None:
            raise ValueError(f"an interval over seeds needs two of them, got {self.seeds}")
        return (max(found[0], 0.0), min(found[1], 100.0)) if self.is_share else found


def over_seeds(by_seed: Mapping[int, Mapping[str, Table]]) -> dict[CellName, OverSeeds]:
    """Joins what each seed measured.

    Args:
        by_seed: seed -> table -> row -> column -> cell, of stages that ran with several seeds.

    Returns:
        Figures that at least two seeds have and that differ between them; settings and texts are not among them.
    """
    collected: dict[CellName, list[float]] = {}
    for tables in by_seed.values():
        for table, rows in tables.items():
            for row, columns in rows.items():
                for column, cell in columns.items():
                    if (
                        column != SAMPLES
                        and not column.endswith(BOUNDS)
                        and cell is not None
                        and not isinstance(cell, str)
                    ):
                        collected.setdefault((table, row, column), []).append(mean_of(cell))
    found = {}
    for name, means in collected.items():
        if len(set(means)) > 1:
            mean = math.fsum(means) / len(means)
            spread = math.sqrt(math.fsum((one - mean) ** 2 for one in means) / len(means))
            found[name] = OverSeeds([mean, spread], len(means), is_share=name[2].endswith(_SHARES))
    return found
