"""95 % intervals of shares and means, of their differences to the thesis's, and of figures over run seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.tables import SAMPLES, Cell, Table, mean_of

Interval = tuple[float, float]
BOUNDS = ("_low_pct", "_high_pct")  # columns that are bounds of intervals themselves
# ends of names of columns that are shares of something
_SHARES = ("success_pct", "safety_pct", "spl_pct")

CellName = tuple[str, str, str]  # table, row, column


def share_interval(percent: float, samples: int | None) -> Interval | None:
    """Wilson's 95 % interval of a share, %; None where its samples are unknown."""
    from cathsim.metrics.episodes import wilson_interval

    if not samples:
        return None
    low, high = wilson_interval(round(percent / 100 * samples), samples)
    return 100 * low, 100 * high


def mean_interval(cell: Cell, samples: int | None) -> Interval | None:
    """Student's 95 % interval of a mean; None for a number alone, or fewer than two samples."""
    from scipy.stats import t

    if not isinstance(cell, list) or not samples or samples < 2:
        return None
    half = float(t.ppf(0.975, samples - 1)) * math.sqrt(_squared_error(cell, samples))
    return cell[0] - half, cell[0] + half


def difference_of_shares(here: float, samples: int, thesis: float, thesis_samples: int | None) -> Interval:
    """Newcombe's 95 % interval of the difference of two shares, percent; unknown samples make a share exact."""
    low, high = share_interval(here, samples) or (here, here)
    thesis_low, thesis_high = share_interval(thesis, thesis_samples) or (thesis, thesis)
    difference = here - thesis
    return (
        difference - math.hypot(here - low, thesis_high - thesis),
        difference + math.hypot(high - here, thesis - thesis_low),
    )


def difference_of_means(here: list[float], samples: int, thesis: Cell, thesis_samples: int | None) -> Interval:
    """Welch's 95 % interval of the difference of two means; unknown samples make the thesis's mean exact."""
    from scipy.stats import t

    own = _squared_error(here, samples)
    known = isinstance(thesis, list) and thesis_samples is not None and thesis_samples > 1
    other = _squared_error(thesis, thesis_samples) if known else 0.0  # type: ignore[arg-type]
    parts = own**2 / (samples - 1) + (other**2 / (thesis_samples - 1) if known else 0.0)  # type: ignore[operator]
    difference = here[0] - mean_of(thesis)
    if not parts:
        return difference, difference
    half = float(t.ppf(0.975, (own + other) ** 2 / parts)) * math.sqrt(own + other)
    return difference - half, difference + half


def _squared_error(cell: list[float], samples: int) -> float:
    """Squared standard error of a mean, whose standard deviation has n in its denominator."""
    return cell[1] ** 2 / (samples - 1)


@dataclass(frozen=True)
class OverSeeds:
    """A figure over several seeds, each of which counts alike."""

    cell: list[float]  # mean and standard deviation (n in the denominator) of the seeds' means
    seeds: int  # how many have the figure
    is_share: bool = False  # of something, so that it lies between 0 and 100 %

    @property
    def interval(self) -> Interval:
        """Student's 95 % interval of the mean; that of a share is cut off at 0 and 100 %."""
        bounds = mean_interval(self.cell, self.seeds)
        if bounds is None:
            raise ValueError(f"an interval over seeds needs two of them, got {self.seeds}")
        return (max(bounds[0], 0.0), min(bounds[1], 100.0)) if self.is_share else bounds


def over_seeds(by_seed: Mapping[int, Mapping[str, Table]]) -> dict[CellName, OverSeeds]:
    """Joins the cells that at least two seeds have, and that differ between them; settings and texts are none."""
    collected: dict[CellName, list[float]] = {}
    for tables in by_seed.values():
        for table, rows in tables.items():
            for row, columns in rows.items():
                for column, cell in columns.items():
                    if column != SAMPLES and not column.endswith(BOUNDS) and isinstance(cell, int | float | list):
                        collected.setdefault((table, row, column), []).append(mean_of(cell))
    cells = {}
    for name, means in collected.items():
        if len(set(means)) > 1:
            mean = math.fsum(means) / len(means)
            spread = math.sqrt(math.fsum((one - mean) ** 2 for one in means) / len(means))
            cells[name] = OverSeeds([mean, spread], len(means), is_share=name[2].endswith(_SHARES))
    return cells
