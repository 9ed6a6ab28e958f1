"""The layout: every table once, results open, the rest folded."""

from __future__ import annotations

from pipeline.report.figures import ShownFigure
from pipeline.report.page import BEYOND, arrange, choose_film
from pipeline.report.tables import report_tables

MEASURED = {
    "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 30}},
    "enn": {"type_1/bca/I+V+M": {"success_pct": 90.0, "n": 30}},
    "expert": {"type_1/bca": {"success_pct": [100.0, 0.0], "n": 3}},
    "generalisation": {"roadmap/bca/unseen": {"success_pct": 70.0, "n": 30}},
}


def figure(title: str, stage: str, *, film: bool = False, width: int = 1400) -> ShownFigure:
    return ShownFigure(title, "", "", "data:,", "image/png", stage=stage, size=(width, 800), is_film=film)


def test_every_table_stands_in_one_place() -> None:
    tables = report_tables(MEASURED)
    chapters = arrange(tables, [])
    placed = [table.key for chapter in chapters for table in (*chapter.settings, *chapter.not_run)]
    placed += [
        table.key for chapter in chapters for block in chapter.blocks for table in (*block.tables, *block.detail)
    ]
    assert sorted(placed) == sorted(table.key for table in tables)
    by_title = {chapter.title: chapter for chapter in chapters}
    enn = next(block for block in by_title["ENN"].blocks if block.stage == "enn")
    assert [table.key for table in enn.tables] == ["ablation"]
    assert [table.key for table in enn.detail] == ["enn"]
    assert "imitation" in [table.key for table in by_title["ENN"].not_run]
    unseen, expert = (next(b for b in by_title[BEYOND].blocks if b.stage == name) for name in ("unseen", "expert"))
    assert [table.key for table in unseen.tables] == ["generalisation"]
    assert expert.is_folded
    assert not expert.tables


def test_the_expert_is_open_where_nothing_else_was_measured() -> None:
    tables = report_tables({"expert": MEASURED["expert"]})
    (block,) = (b for chapter in arrange(tables, [figure("paths", "expert")]) for b in chapter.blocks)
    assert [table.key for table in block.tables] == ["expert"]
    assert [one.title for one in block.beside] == ["paths"]


def test_two_figures_stand_beside_the_tables_and_more_are_folded() -> None:
    shown = [
        figure("wide", "enn", width=3000),
        *(figure(name, "enn") for name in "abc"),
        figure("film", "enn", film=True),
    ]
    blocks = [b for chapter in arrange(report_tables(MEASURED), shown) for b in chapter.blocks if b.stage == "enn"]
    assert [one.title for one in blocks[0].beside] == ["a", "b"]
    assert [one.title for one in blocks[0].further] == ["wide", "c", "film"]


def test_the_film_is_that_of_the_stage_that_shows_most() -> None:
    films = [figure("expert", "expert", film=True), figure("navigation", "navigation", film=True)]
    assert choose_film(films) is films[1]
    assert choose_film([figure("picture", "expert")]) is None
