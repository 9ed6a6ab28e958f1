"""The thesis, table by table: one source for the report and the page, verdicts only where the same was measured."""

from __future__ import annotations

import re
from collections import defaultdict

from pipeline.report.comparison import NOT_MEASURED, PAGE, comparisons, rendered
from pipeline.report.headlines import headline_specs
from pipeline.report.page import render_page
from pipeline.report.tables import report_tables
from pipeline.store.provenance import PROJECT_ROOT


def test_the_page_has_the_tables_of_the_source() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert rendered(text) == text, "run python -m pipeline.report.comparison"
    assert rendered(text.replace("| 83.3 |", "| 100 |")) == text


def test_the_kept_figures_of_three_seeds_and_of_the_pages_are_shown() -> None:
    rows = {row[0]: row[1:] for row in comparisons()["imitation"].rows}
    assert rows["BCA, Image with ENN"] == ("100 ± 0", "83.3", "98.9")
    for one in comparisons().values():
        page = (PROJECT_ROOT / "docs" / one.page.partition("#")[0]).read_text(encoding="utf-8")
        typed = {cell for _, _, *cells in one.rows for cell in cells if cell != NOT_MEASURED and "±" in cell}
        for number in re.findall(r"\d+\.\d+ ± \d+\.\d+", " ".join(typed)):
            assert number in page, f"{one.table}: {one.page} does not say {number}"


def test_a_verdict_needs_the_same_thing_to_be_measured() -> None:
    alike = {spec.table for spec in headline_specs() if spec.comparable}
    for one in comparisons().values():
        assert one.differs
        assert one.verdict == "not comparable" or one.table in alike
    results = {table.key for table in report_tables({}) if table.kind == "results" and table.stage}
    elsewhere = {
        "user_study", "training_time_h", "training_speed_fps", "guide3d_composition", "guide3d_reprojection_px",
    }  # fmt: skip
    assert results - set(comparisons()) == elsewhere


def test_the_report_shows_them_beside_the_cells() -> None:
    page = render_page(
        run="x", budget="desk", seeds=[0], written="2026-01-01T00:00:00", records=[], tables=report_tables({}),
        figures=[], commit="", versions={}, machine=defaultdict(str),
    )  # fmt: skip
    assert page.count("As written, and ours") == len(comparisons())
    assert all(one.differs.split(".")[0] in page.replace("&#39;", "'") for one in comparisons().values())
