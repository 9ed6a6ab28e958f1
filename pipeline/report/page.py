"""The page of the report: one static HTML file that needs no network, from tables, figures and provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from pipeline.report.figures import ShownFigure
from pipeline.report.headlines import headlines
from pipeline.report.layout import arrange, choose_film
from pipeline.report.table_formats import format_over_seeds
from pipeline.report.tables import NOT_RUN, ReportTable
from pipeline.store.manifest import Manifest
from pipeline.tables import format_cell
from pipeline.words import place_in_thesis, row_words

PAGE = "index.html"
_TEMPLATE = Path(__file__).with_name("page.html.j2")
_STYLE = Path(__file__).with_name("page.css")


_STAGES = {
    "phantoms": "Phantoms", "expert": "Sampling expert", "validate": "Validation", "user_study": "User study",
    "guide3d": "Guide3D", "shape": "Shape prediction", "splineformer": "SplineFormer", "force": "Force prediction",
    "navigation": "Autonomous navigation",
}  # fmt: skip


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
    tables: Sequence[ReportTable], figures: Sequence[ShownFigure], commit: str, versions: dict[str, str],
    machine: dict[str, str], remarks: Mapping[str, str] | None = None, made: Mapping[str, Sequence[str]] | None = None,
) -> str:  # fmt: skip
    """Renders the page as HTML.

    Args:
        budget: of the stages; several are joined by "+".
        written: when, ISO 8601.
        records: every stage, run or not.
        tables: of the thesis, and own ones.
        figures: in the order they are shown.
        commit: of the code that renders.
        remarks: table -> what the reader should know of its cells, e.g. which logs were left out.
        made: table -> how its measured rows were made, a note a stage folder.
    """
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["cell"] = format_cell
    environment.filters["over_seeds"] = format_over_seeds
    environment.filters["place"] = place_in_thesis
    environment.filters["stage_words"] = lambda stage: row_words(stage.partition("@")[0], _STAGES)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    compared = headlines(tables)
    film = choose_film(figures)
    return template.render(
        run=run, budget=budget, seeds=", ".join(map(str, seeds)), written=written, records=records,
        is_smoke="smoke" in budget.split("+"), not_run=NOT_RUN, commit=commit, versions=versions, machine=machine,
        remarks=dict(remarks or {}), made=dict(made or {}), style=_STYLE.read_text(encoding="utf-8"), film=film,
        compared=[one for one in compared if one.here], open_headlines=[one for one in compared if not one.here],
        chapters=arrange(tables, [figure for figure in figures if figure is not film]),
    )  # fmt: skip


def wall_time(seconds: float) -> str:
    """Words a duration: ``8.2 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"
