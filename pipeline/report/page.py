"""The page of the report: one static HTML file that needs no network, its tables and figures arranged in chapters."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2

from pipeline.plots.words import place_in_thesis, row_words
from pipeline.report.comparison import comparisons
from pipeline.report.figures import ShownFigure
from pipeline.report.headlines import headlines
from pipeline.report.tables import NOT_RUN, ReportTable, format_over_seeds
from pipeline.store.manifest import Manifest
from pipeline.tables import format_cell

BEYOND, DETAIL = "Beyond the thesis", "Learning in detail"
FIGURES_SHOWN = 2  # beside the tables of a stage; more are folded
ROWS_BESIDE = 12  # of tables that are as tall as two figures; fewer have one beside them
APPENDIX = "app"  # labels in the thesis's appendices: such tables are folded
COLUMNS_BESIDE = 8  # of a table that leaves room for figures beside it
COLUMNS_NARROW = 5  # of tables that leave room for two figures side by side
_FILMS_OF = ("navigation", "unseen", "enn", "expert")  # whose film comes first


@dataclass
class Block:
    """What one stage left."""

    stage: str
    tables: list[ReportTable] = field(default_factory=list)  # shown at once, figures beside them
    detail: list[ReportTable] = field(default_factory=list)  # own tables, folded
    figures: list[ShownFigure] = field(default_factory=list)
    is_folded: bool = False  # all of it is, figures too

    @property
    def is_stacked(self) -> bool:
        """Whether a table needs the whole width, so that the figures stand beneath."""
        return any(len(table.columns) > COLUMNS_BESIDE for table in self.tables)

    @property
    def beside(self) -> list[ShownFigure]:
        """The figures beside the tables; where all are too wide for that, one that is shown beneath them."""
        if self.is_folded:
            return []
        pictures = [figure for figure in self.figures if not figure.is_film]
        tall = sum(len(table.rows) for table in self.tables) >= ROWS_BESIDE
        narrow = sum(len(table.columns) for table in self.tables) <= COLUMNS_NARROW
        count = FIGURES_SHOWN if tall or narrow else 1
        return [figure for figure in pictures if not figure.is_wide][:count] or pictures[:1]

    @property
    def further(self) -> list[ShownFigure]:
        beside = self.beside
        return [figure for figure in self.figures if figure not in beside]


@dataclass
class Chapter:
    """A chapter of the page."""

    title: str
    # Blocks of the stages that left results; stages with most tables of the thesis come first.
    blocks: list[Block] = field(default_factory=list)
    settings: list[ReportTable] = field(default_factory=list)  # tables of settings and of the literature, folded
    not_run: list[ReportTable] = field(default_factory=list)  # tables that nothing was measured of, folded


def choose_film(figures: Sequence[ShownFigure]) -> ShownFigure | None:
    """The film below the headlines: the first of the stage that shows most; None without films."""
    films = [figure for figure in figures if figure.is_film]
    order = {stage: place for place, stage in enumerate(_FILMS_OF)}
    return min(films, key=lambda film: order.get(film.stage, len(order)), default=None)


def arrange(tables: Sequence[ReportTable], figures: Sequence[ShownFigure]) -> list[Chapter]:
    """Arranges tables and figures in chapters.

    A stage stands in the chapter of its results in the thesis, or of its first own table. Every table is on the page
    once: results open, own tables of a stage that has results folded beneath them, settings and what has not run, too.
    Stages that only describe phantoms and the planner are folded where the run has results.
    """
    titles = dict.fromkeys(table.chapter for table in tables if table.chapter not in (BEYOND, DETAIL))
    chapters = {title: Chapter(title) for title in (*titles, BEYOND)}
    homes = _homes(tables)
    blocks: dict[str, Block] = {}

    def block(stage: str) -> Block:
        if stage not in blocks:
            blocks[stage] = Block(stage)
            chapters[homes.get(stage, BEYOND)].blocks.append(blocks[stage])
        return blocks[stage]

    for table in tables:
        home = table.chapter if table.chapter in chapters else homes.get(table.stage, BEYOND)
        if table.kind in ("settings", "literature"):
            chapters[home].settings.append(table)
        elif table.kind == "own" or (table.has_run and table.label.startswith(APPENDIX)):
            block(table.stage or table.key).detail.append(table)
        elif table.has_run:
            block(table.stage or table.key).tables.append(table)
        else:
            chapters[home].not_run.append(table)
    for figure in figures:
        block(figure.stage).figures.append(figure)
    has_results = any(one.tables for one in blocks.values())
    for one in blocks.values():
        one.is_folded = has_results and not one.tables and bool(one.detail) and one.detail[0].chapter == BEYOND
        if not one.tables and one.detail and not one.is_folded:
            one.tables.append(one.detail.pop(0))
        one.tables.sort(key=lambda table: len(table.rows) * len(table.columns))
        one.tables = [*one.tables[-1:], *one.tables[:-1]]  # the largest first; small ones fit beside each other
    return [chapter for chapter in chapters.values() if chapter.blocks or chapter.settings or chapter.not_run]


def _homes(tables: Sequence[ReportTable]) -> dict[str, str]:
    """Stage to its chapter: that of its first table of results, else of its first table outside the details."""
    homes: dict[str, str] = {}
    for kind in ("results", "own"):
        for table in tables:
            if table.kind == kind and table.stage and table.chapter != DETAIL:
                homes.setdefault(table.stage, table.chapter)
    return homes


PAGE = "index.html"
_TEMPLATE = Path(__file__).with_name("page.html.j2")
_STYLE = Path(__file__).with_name("page.css")


_STAGES = {
    "phantoms": "Phantoms", "expert": "Sampling expert", "validate": "Validation", "user_study": "User study",
    "guide3d": "Guide3D", "shape": "Shape prediction", "splineformer": "SplineFormer", "force": "Force prediction",
    "navigation": "Autonomous navigation",
}  # fmt: skip


def render_page(
    *, run: str, budget: str, seeds: Sequence[int], written: str, records: Mapping[str, Manifest | None],
    tables: Sequence[ReportTable], figures: Sequence[ShownFigure], commit: str, versions: dict[str, str],
    machine: dict[str, str], remarks: Mapping[str, str] | None = None, made: Mapping[str, Sequence[str]] | None = None,
) -> str:  # fmt: skip
    """Renders the page as HTML.

    Args:
        budget: of the stages; several are joined by "+".
        written: when, ISO 8601.
        records: every stage folder and its manifest; None of a stage that has not run.
        tables: of the thesis, and own ones.
        figures: in the order they are shown.
        commit: of the code that renders.
        remarks: table -> what the reader should know of its cells, e.g. which logs were left out.
        made: table -> how its measured rows were made, a note a stage folder.
    """
    compared = headlines(tables)
    film = choose_film(figures)
    return _template().render(
        run=run, budget=budget, seeds=", ".join(map(str, seeds)), written=written, records=records,
        is_smoke="smoke" in budget.split("+"), not_run=NOT_RUN, commit=commit, versions=versions, machine=machine,
        remarks=dict(remarks or {}), made=dict(made or {}), style=_STYLE.read_text(encoding="utf-8"), film=film,
        beside=comparisons(), compared=[one for one in compared if one.here],
        open_headlines=[one for one in compared if not one.here],
        chapters=arrange(tables, [figure for figure in figures if figure is not film]),
    )  # fmt: skip


@functools.cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["cell"] = format_cell
    environment.filters["over_seeds"] = format_over_seeds
    environment.filters["place"] = place_in_thesis
    environment.filters["wall_time"] = wall_time
    environment.filters["stage_words"] = lambda stage: row_words(stage.partition("@")[0], _STAGES)
    return environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))


def wall_time(seconds: float) -> str:
    """Words a duration: ``8.2 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"
