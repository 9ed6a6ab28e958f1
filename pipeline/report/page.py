"""The page of the report: one static HTML file that needs no network, from tables, figures and provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import jinja2

from pipeline.report.figures import ShownFigure
from pipeline.report.table_formats import format_cell
from pipeline.report.tables import NOT_RUN, ReportTable
from pipeline.store.manifest import Manifest

PAGE = "index.html"
_TEMPLATE = Path(__file__).with_name("page.html.j2")


@dataclass(frozen=True)
class StageRecord:
    """What the page says about one stage folder, or about a stage that has not run."""

    name: str
    manifest: Manifest | None

    @property
    def wall_time(self) -> str:
        """Its wall time in words."""
        return wall_time(self.manifest.wall_time_s) if self.manifest else NOT_RUN


def render_page(
    *, run: str, budget: str, seeds: Sequence[int], written: str, records: Sequence[StageRecord],
    tables: Sequence[ReportTable], figures: Sequence[ShownFigure], git: dict[str, Any], versions: dict[str, str],
    machine: dict[str, str], remarks: Mapping[str, str] | None = None, made: Mapping[str, Sequence[str]] | None = None,
) -> str:  # fmt: skip
    """Renders the page as HTML.

    Args:
        budget: of the stages; several are joined by "+".
        written: when, ISO 8601.
        records: every stage, run or not.
        tables: of the thesis, and own ones.
        figures: in the order they are shown.
        git: commit of the code that renders, and whether it had changes.
        remarks: table -> what the reader should know of its cells, e.g. which logs were left out.
        made: table -> how its measured rows were made, a note a stage folder.
    """
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["cell"] = format_cell
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        run=run, budget=budget, seeds=", ".join(map(str, seeds)), written=written, records=records,
        is_smoke="smoke" in budget.split("+"), not_run=NOT_RUN, git=git, versions=versions, machine=machine,
        remarks=dict(remarks or {}), made=dict(made or {}),
        chapters=[(name, list(group)) for name, group in groupby(_by_chapter(tables), key=lambda t: t.chapter)],
        figure_groups=[(name, list(group)) for name, group in groupby(figures, key=lambda f: f.group)],
        measured=sum(t.measured_cells for t in tables), cells=sum(max(t.cells, t.measured_cells) for t in tables),
        tables_run=sum(t.has_run for t in tables), table_count=len(tables),
    )  # fmt: skip


def _by_chapter(tables: Sequence[ReportTable]) -> list[ReportTable]:
    order = list(dict.fromkeys(table.chapter for table in tables))
    return sorted(tables, key=lambda table: order.index(table.chapter))


def wall_time(seconds: float) -> str:
    """Words a duration: ``8.2 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"
