"""The thesis, table by table: its values, what its recipe gives here as it is written, and ours; for report and page.

python -m pipeline.report.comparison   # writes the tables into docs/thesis.md anew
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from pipeline.report.tables import Column, ReportTable, report_tables
from pipeline.store.atomic_files import read_json, write_text
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.tables import Table, format_cell, mean_of

PAGE = PROJECT_ROOT / "docs" / "thesis.md"
VERDICTS = ("same", "better", "worse", "not comparable")
NOT_MEASURED = "not measured"
_SPECS = Path(__file__).with_name("comparison.yaml")
_RUNS = PROJECT_ROOT / "docs" / "results" / "desk_run"
_MARKED = re.compile(r"(<!-- tables of the thesis -->\n).*?(<!-- end of tables -->)", re.DOTALL)


@dataclass(frozen=True)
class Comparison:
    """A table of the thesis beside what was measured here.

    Attributes:
        columns: what is compared, in words.
        rows: label, thesis, as written, ours.
    """

    table: str
    title: str
    page: str
    verdict: str
    differs: str
    columns: str
    rows: tuple[tuple[str, str, str, str], ...]


@functools.cache
def comparisons() -> dict[str, Comparison]:
    """Key of each table that is compared, in the thesis's order, to its comparison; none without the documents' runs.

    Raises:
        KeyError: a table, row or column that the thesis does not have.
        ValueError: an unknown verdict.
    """
    tables = {table.key: table for table in report_tables({})}
    runs = [read_json(path) for path in sorted(_RUNS.glob("seed*.json"))]
    made: dict[str, Comparison] = {}
    for spec in yaml.safe_load(_SPECS.read_text(encoding="utf-8")) if runs else ():
        if spec["verdict"] not in VERDICTS:
            raise ValueError(f"{spec['table']}: the verdict '{spec['verdict']}' is none of {', '.join(VERDICTS)}")
        table = tables[spec["table"]]
        columns = [{column.key: column for column in table.columns}[key] for key in spec["columns"]]
        run_tables = [run.get(table.key, {}) for run in runs]
        made[table.key] = Comparison(
            table.key, table.title, spec["page"], spec["verdict"], spec["differs"], _heading(columns),
            tuple(_row(table, key, columns, cells, run_tables) for key, cells in spec["rows"].items()),
        )  # fmt: skip
    return made


def _heading(columns: Sequence[Column]) -> str:
    unit = f", {columns[0].unit}" if columns[0].unit else ""
    return "; ".join(column.label for column in columns) + unit


def _row(
    table: ReportTable, key: str, columns: Sequence[Column], cells: Sequence[str], runs: Sequence[Table]
) -> tuple[str, str, str, str]:
    row = {row.key: row for row in table.rows}[key]
    written, ours = (_words(cell, columns, runs) for cell in cells)
    label = f"{row.group}, {row.label}" if row.group else row.label
    return label, _joined([format_cell(row.thesis[one.key], one.decimals) for one in columns]), written, ours


def _words(cell: str, columns: Sequence[Column], runs: Sequence[Table]) -> str:
    """A text, or the mean over the seeds of a row that they hold."""
    if not all(cell in run for run in runs):
        return cell or NOT_MEASURED
    means = [sum(mean_of(run[cell][one.key]) for run in runs) / len(runs) for one in columns]
    return _joined([f"{mean:.3g}" for mean in means])


def _joined(cells: Sequence[str]) -> str:
    return "; ".join(cell or "-" for cell in cells)


def rendered(text: str) -> str:
    """The page's text with its tables made anew."""
    parts = []
    for one in comparisons().values():
        lines = [f"| {' | '.join(row)} |" for row in ((one.columns, "thesis", "as written, here", "ours"), *one.rows)]
        table = "\n".join([lines[0], "|---|---|---|---|", *lines[1:]])
        verdict = one.verdict.capitalize()
        parts.append(f"### {one.title}\n\n{table}\n\n**{verdict}** ([figures]({one.page})). {one.differs}\n")
    return _MARKED.sub(lambda match: f"{match[1]}\n{chr(10).join(parts)}\n{match[2]}", text)


if __name__ == "__main__":
    write_text(PAGE, rendered(PAGE.read_text(encoding="utf-8")))
