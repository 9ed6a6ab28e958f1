"""Cells of a run's tables that are worse than in earlier runs by more than their 95 % interval, from `metrics.json`.

    python benchmarks/pipeline/compare_tables.py EARLIER.json [EARLIER.json ...] runs/desk/report/metrics.json
    python benchmarks/pipeline/compare_tables.py --quick    # two runs of four cells, made up for it

A share is compared by Newcombe's interval of the difference, a mean with a standard deviation by Welch's, each of as
many samples as its row tells (`n`). A number alone has no interval: it is told where it is worse by more than
`--factor`. Columns that are neither better nor worse (settings, times) are left out. The intervals know episodes
and images alone, and two trainings differ by more: with several earlier runs, say of other seeds, a cell is told where
it is worse (better) than in each of them. Keys of the last line: compared, worse, better, alone, alone_worse, missing
(cells that only the first of the earlier runs has).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.report.intervals import Interval, difference_of_means, difference_of_shares
from pipeline.tables import SAMPLES, Cell, Table, format_cell, mean_of

# parts of names of columns of which more is better, and less
_HIGHER = ("success", "safety_pct", "spl_pct", "dice", "miou", "jaccard", "recognised", "read_pct", "reward", "score")
_LOWER = ("force", "mse", "_px", "max_ed", "mete", "mers", "frechet", "chamfer", "error", "path_length", "steps")
_NEITHER = ("low_pct", "high_pct", "interval", "image_px", "time_steps", "_share", "limit", "source_px")
_SHARES = ("success", "safety_pct", "read_pct")  # of what n counts

_MADE_UP: list[dict[str, Table]] = [
    {"trials": {"bca": {"success_pct": success, "force_n": [force, 0.02], "mse_n2": mse, "minutes": 3.0, "n": 50}}}
    for success, force, mse in ((98.0, 0.05, 1.0), (70.0, 0.03, 1.05))
]


@dataclass
class Comparison:
    """Lines about cells, by what became of them, and how many there were."""

    worse: list[str] = field(default_factory=list)
    better: list[str] = field(default_factory=list)
    alone_worse: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    compared: int = 0
    alone: int = 0


def direction(column: str) -> int:
    """1 where more is better in a column, -1 where less is, 0 where neither."""
    if any(part in column for part in _NEITHER):
        return 0
    if any(part in column for part in _HIGHER):
        return 1
    return -1 if any(part in column for part in _LOWER) else 0


def difference(column: str, new: Cell, new_samples: int | None, old: Cell, old_samples: int | None) -> Interval | None:
    """The interval of new minus old; None for numbers alone."""
    if not new_samples or not old_samples:
        return None
    if any(part in column for part in _SHARES):
        return difference_of_shares(mean_of(new), new_samples, mean_of(old), old_samples)
    if isinstance(new, list) and isinstance(old, list) and min(new_samples, old_samples) > 1:
        return difference_of_means(new, new_samples, old, old_samples)
    return None


def cells(earlier: Mapping[str, Table]) -> Iterator[tuple[str, str, str]]:
    """Table, row and column of each measured number that is better or worse than another."""
    for table, rows in earlier.items():
        for row, columns in rows.items():
            for column, cell in columns.items():
                if direction(column) and cell is not None and not isinstance(cell, str):
                    yield table, row, column


def compare(runs: Sequence[Mapping[str, Table]], factor: float) -> Comparison:
    """Compares the numbers of the last run with those of all earlier ones."""
    *earlier, new = runs
    found = Comparison()
    for table, row, column in cells(earlier[0]):
        columns = new.get(table, {}).get(row, {})
        cell, name = columns.get(column), f"{table} | {row} | {column}"
        if cell is None or isinstance(cell, str):
            found.missing.append(name)
            continue
        rows = [run.get(table, {}).get(row, {}) for run in earlier]
        old = [(other[column], _samples(other)) for other in rows if not isinstance(other.get(column), str | None)]
        told = f"{name}: {', '.join(format_cell(value) for value, _ in old)}, now {format_cell(cell)}"
        sign, samples = direction(column), _samples(columns)
        intervals = [difference(column, cell, samples, *one) for one in old]
        known = [interval for interval in intervals if interval is not None]
        if len(known) < len(old):
            found.alone += 1
            if all(_is_worse(mean_of(cell), mean_of(value), sign, factor) for value, _ in old):
                found.alone_worse.append(told)
            continue
        found.compared += 1
        if all(max(sign * bound for bound in interval) < 0 for interval in known):
            found.worse.append(told)
        elif all(min(sign * bound for bound in interval) > 0 for interval in known):
            found.better.append(told)
    return found


def _samples(columns: Mapping[str, Cell]) -> int | None:
    count = columns.get(SAMPLES)
    return int(count) if isinstance(count, int | float) else None


def _is_worse(new: float, old: float, sign: int, factor: float) -> bool:
    return sign * (new - old) < 0 and max(abs(new), abs(old)) > factor * min(abs(new), abs(old))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "metrics", type=Path, nargs="*", metavar="METRICS", help="of the earlier runs, then of the new one"
    )
    parser.add_argument("--quick", action="store_true", help="two runs that are made up")
    parser.add_argument("--factor", type=float, default=1.1, help="by which a number alone is told as worse")
    given = parser.parse_args()
    if given.quick:
        runs = _MADE_UP
    else:
        if len(given.metrics) < 2:
            parser.error(
                "name at least two files: metrics.json of an earlier run, or what run_tables.py kept, and a new one's"
            )
        missing = [str(path) for path in given.metrics if not path.is_file()]
        if missing:
            parser.error(f"there is no {missing[0]}")
        runs = [json.loads(path.read_text(encoding="utf-8")) for path in given.metrics]
    found = compare(runs, given.factor)
    for title, lines in (
        ("worse by more than the interval", found.worse),
        ("better by more than the interval", found.better),
        (f"numbers alone, worse by more than a factor of {given.factor:g}", found.alone_worse),
        ("only in the first of the earlier runs", found.missing),
    ):
        print(f"{title}: {len(lines)}", *(f"  {line}" for line in lines), sep="\n")
    counts = {name: len(value) if isinstance(value, list) else value for name, value in vars(found).items()}
    print(json.dumps(counts))


if __name__ == "__main__":
    main()
