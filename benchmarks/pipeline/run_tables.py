"""Tables of one or several runs as Markdown, from the `metrics.json` of their reports: several are joined over seeds.

    python benchmarks/pipeline/run_tables.py runs/desk/report/metrics.json
    python benchmarks/pipeline/run_tables.py seed0.json seed1.json seed2.json --tables generalisation navigation
    python benchmarks/pipeline/run_tables.py --quick    # of two runs of three cells, made up for it

Of one run a cell is its value, or mean ± standard deviation; of several, one for each seed, it is the mean of their
means and Student's 95 % interval, or the value that all of them have. So the seeds of `make all SEEDS=3` may run one by
one, on several machines. `--keep FILE` writes the measured cells of one run alone, for the next time. Keys of the last
line: runs, tables, cells (over seeds: that differ between them).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.report.intervals import BOUNDS, OverSeeds, over_seeds
from pipeline.report.tables import OVER_SEEDS
from pipeline.tables import SAMPLES, Cell, Table, format_cell

_MADE_UP: list[dict[str, Table]] = [
    {"generalisation": {"roadmap/bca": {"success_pct": success, "force_n": [force, 0.01], "wire": "default"}}}
    for success, force in ((90.0, 0.05), (96.0, 0.07))
]


def measured(path: Path) -> dict[str, Table]:
    """The tables of a run without rows and columns that were not measured."""
    tables: dict[str, Table] = {}
    for name, rows in json.loads(path.read_text(encoding="utf-8")).items():
        kept = {
            row: {key: cell for key, cell in cells.items() if cell is not None and key != OVER_SEEDS}
            for row, cells in rows.items()
        }
        tables[name] = {row: cells for row, cells in kept.items() if set(cells) - {SAMPLES}}
    return {name: rows for name, rows in tables.items() if rows}


def words(cell: Cell, joined: OverSeeds | None) -> str:
    """A cell of one run, or over seeds."""
    if joined is None:
        return format_cell(cell)
    mean, low, high = (format_cell(float(f"{value:.3g}")) for value in (joined.cell[0], *joined.interval))
    return f"{mean} ({low} to {high})"


def as_markdown(
    name: str, rows: Table, joined: Mapping[tuple[str, str, str], OverSeeds], wanted: Sequence[str] | None = None
) -> str:
    """A table under its heading, with all columns or with those that are wanted."""
    several = bool(joined)
    columns = list(dict.fromkeys(column for cells in rows.values() for column in cells if column != SAMPLES))
    columns = [column for column in columns if not (several and column.endswith(BOUNDS))]
    if wanted and set(wanted) & set(columns):
        columns = [column for column in columns if column in wanted]
    lines = [f"| {name} | {' | '.join(columns)} |", "|" + "---|" * (len(columns) + 1)]
    for row, cells in rows.items():
        cells_text = [words(cells.get(column), joined.get((name, row, column))) for column in columns]
        lines.append(f"| {row} | {' | '.join(cells_text)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("metrics", type=Path, nargs="*", metavar="METRICS", help="metrics.json of a run's report")
    parser.add_argument("--quick", action="store_true", help="two runs that are made up")
    parser.add_argument("--tables", nargs="+", metavar="NAME", help="only these")
    parser.add_argument("--columns", nargs="+", metavar="NAME", help="only these, in tables that have one of them")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="write the measured cells of one run there")
    given = parser.parse_args()
    if given.quick:
        print(*tables_of(_MADE_UP, list(_MADE_UP[0])), sep="\n\n")
        print(json.dumps(counts(_MADE_UP, list(_MADE_UP[0]))))
        return
    if not given.metrics:
        parser.error("name the metrics.json of a run's report")
    missing = [str(path) for path in given.metrics if not path.is_file()]
    if missing or (given.keep and len(given.metrics) > 1):
        parser.error(f"there is no {missing[0]}" if missing else "--keep takes the metrics of one run")
    runs = [measured(path) for path in given.metrics]
    unknown = sorted(set(given.tables or ()) - set(runs[0]))
    if unknown:
        parser.error(f"unknown table {unknown[0]}: there are {', '.join(runs[0])}")
    names = [name for name in runs[0] if not given.tables or name in given.tables]
    if given.keep:
        kept = json.dumps({name: runs[0][name] for name in names}, indent=1)
        given.keep.write_text(kept + "\n", encoding="utf-8")
    print(*tables_of(runs, names, given.columns), sep="\n\n")
    print(json.dumps(counts(runs, names)))


def tables_of(
    runs: Sequence[dict[str, Table]], names: Sequence[str], columns: Sequence[str] | None = None
) -> list[str]:
    """The tables of these names, joined over the runs."""
    joined = over_seeds(dict(enumerate(runs))) if len(runs) > 1 else {}
    return [as_markdown(name, runs[0][name], joined, columns) for name in names]


def counts(runs: Sequence[dict[str, Table]], names: Sequence[str]) -> dict[str, Any]:
    """Numbers of runs, tables, and cells or, of several runs, cells that differ between them."""
    if len(runs) > 1:
        cells = sum(table in names for table, _, _ in over_seeds(dict(enumerate(runs))))
    else:
        cells = sum(len(set(cells) - {SAMPLES}) for name in names for cells in runs[0][name].values())
    return {"runs": len(runs), "tables": len(names), "cells": cells}


if __name__ == "__main__":
    main()
