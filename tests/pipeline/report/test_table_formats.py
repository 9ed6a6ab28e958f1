"""Words of cells, CSV and LaTeX."""

from __future__ import annotations

import pytest

from pipeline.report.intervals import OverSeeds
from pipeline.report.tables import as_csv, as_latex, format_over_seeds, metrics, report_tables
from pipeline.tables import format_cell


@pytest.mark.parametrize(
    ("cell", "decimals", "expected"),
    [(None, None, ""), ("text", 2, "text"), ([0.1234, 0.05], None, "0.123 ± 0.050"), ([-70, 28], 0, "-70 ± 28"),
     (590080, None, "590,080"), (0.0003, None, "0.0003"), (93.14, 0, "93"), (7.0, None, "7")],
)  # fmt: skip
def test_cells_are_worded(cell: object, decimals: int | None, expected: str) -> None:
    assert format_cell(cell, decimals) == expected  # type: ignore[arg-type]


def test_csv_and_latex_hold_both_sides() -> None:
    table = next(t for t in report_tables({"ablation": {"bca/H": {"force_n": [0.5, 0.1]}}}) if t.key == "ablation")
    assert as_csv(table).splitlines()[1].startswith("bca/H,1.02 ± 0.22,0.50 ± 0.10,28.82 ± 11.80,,")
    assert r"H & 1.02 $\pm$ 0.22 & 0.50 $\pm$ 0.10 & 28.82 $\pm$ 11.80 & --" in as_latex(table)
    assert metrics([table])["ablation"]["bca/H"]["force_n"] == [0.5, 0.1]


def test_figures_over_seeds_follow_the_others() -> None:
    force = OverSeeds([0.5, 0.0816], 3)
    measured = {"ablation": {"bca/H": {"force_n": [0.5, 0.1]}, "bca/V": {"force_n": [0.4, 0.1]}}}
    tables = report_tables(measured, {("ablation", "bca/H", "force_n"): force})
    table = next(t for t in tables if t.key == "ablation")
    head, first, second = as_csv(table).splitlines()[:3]
    assert head.endswith(",samples,force_n_seeds_mean,force_n_seeds_low,force_n_seeds_high")
    assert first.endswith(",0.50,0.25,0.75")
    assert second.endswith(",,,")
    assert format_over_seeds(force, 2) == "3 seeds: 0.50 (0.25 to 0.75)"
    written = metrics([table])["ablation"]["bca/H"]["over_seeds"]["force_n"]
    assert (written["mean"], written["seeds"]) == (0.5, 3)
    assert "over_seeds" not in metrics([table])["ablation"]["bca/V"]
