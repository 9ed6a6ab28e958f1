"""What a stage wrote of its evaluations against what its logs say: the logs' cells count, and differences are named."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.report.learning.tables import OWN_TABLES
from pipeline.report.results import SAMPLES, Cell, Table
from pipeline.report.tables import format_cell

FROM_LOGS = ("cathsim_results", "ablation", "imitation", *OWN_TABLES.values())
SPL = "spl_pct"
_SHOWN = 4  # differences that a remark spells out

Tables = Mapping[str, Table]


@dataclass(frozen=True)
class Difference:
    """A cell of a stage's own results that its logs do not give.

    Attributes:
        folder: of the stage.
        table: its key.
        row: likewise.
        column: likewise; empty where the logs give nothing of the row.
        written: the stage's cell.
        computed: the logs'; None where they give none.
    """

    folder: str
    table: str
    row: str
    column: str
    written: Cell
    computed: Cell

    @property
    def is_later_way(self) -> bool:
        """Whether it is an SPL, which falls when a later stage finds a shorter way."""
        return self.column == SPL


def differences(folder: str, results: Tables, own: Tables, joint: Tables) -> list[Difference]:
    """Compares a stage's results with those from its logs.

    Args:
        folder: of the stage.
        results: what it wrote.
        own: computed from its logs.
        joint: computed from all logs of the run, for rows that it repeats from another stage.

    Returns:
        Every cell that differs, and every row of these tables without a log. Columns that logs say nothing of, and
        tables that are not computed from them, are left alone.
    """
    found = []
    for table in FROM_LOGS:
        for row, cells in results.get(table, {}).items():
            computed = own.get(table, {}).get(row, joint.get(table, {}).get(row))
            if computed is None:
                found.append(Difference(folder, table, row, "", None, None))
                continue
            for column, cell in cells.items():
                if column in computed and not same(cell, computed[column]):
                    found.append(Difference(folder, table, row, column, cell, computed[column]))
    return found


def same(one: Cell, other: Cell) -> bool:
    """Whether two cells are equal up to rounding."""
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-6)
    return one == other


def with_logs(parts: Iterable[Mapping[str, Table]], tables: Tables) -> list[dict[str, Table]]:
    """Puts the cells from logs in the place of those the stages wrote.

    Args:
        parts: each stage folder's results.
        tables: computed from all logs.

    Returns:
        The logs' tables, and the parts without the cells that they give.
    """
    kept: list[dict[str, Table]] = []
    for part in parts:
        without: dict[str, Table] = {}
        for table, rows in part.items():
            given = tables.get(table, {})
            without[table] = {
                row: {column: cell for column, cell in cells.items() if column not in given.get(row, {})}
                for row, cells in rows.items()
            }
        kept.append(without)
    return [dict(tables), *kept]  # first, so that the rows stand in their order


def remarks(found: Sequence[Difference]) -> dict[str, str]:
    """Words the differences.

    Args:
        found: of all stages.

    Returns:
        Table to what its page says.
    """
    words: dict[str, list[str]] = {}
    for table in dict.fromkeys(one.table for one in found):
        here = [one for one in found if one.table == table]
        differing = [one for one in here if one.column and not one.is_later_way]
        if differing:
            cells = [
                f"{one.row}, {'episodes' if one.column == SAMPLES else one.column}: "
                f"{_cell(one.written)} there, {_cell(one.computed)} from the logs"
                for one in differing
            ]
            folders = ", ".join(dict.fromkeys(one.folder for one in differing))
            words.setdefault(table, []).append(
                f"The results.json of {folders} differs from its logs in {_count(len(cells), 'cell')}; the logs' are "
                f"shown ({_listed(cells)})."
            )
        lost = [f"{one.row} of {one.folder}" for one in here if not one.column]
        if lost:
            words.setdefault(table, []).append(
                f"{_count(len(lost), 'row')} without a log to compute it from, shown as the stage wrote it: "
                f"{_listed(lost)}."
            )
        later = [one for one in here if one.column and one.is_later_way]
        if later:
            words.setdefault(table, []).append(
                f"SPL differs from the stage's own in {_count(len(later), 'row')}: the shortest way is taken over "
                "every episode of the run, also those recorded since."
            )
    return {table: " ".join(sentences) for table, sentences in words.items()}


def _cell(cell: Cell) -> str:
    return format_cell(cell, None) or "nothing"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _listed(items: Sequence[str]) -> str:
    more = f"; and {len(items) - _SHOWN} more" if len(items) > _SHOWN else ""
    return "; ".join(items[:_SHOWN]) + more
