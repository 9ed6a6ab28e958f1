"""Words of cells, CSV and LaTeX."""

from __future__ import annotations

import pytest

from pipeline.report.table_formats import as_csv, as_latex, format_cell
from pipeline.report.tables import metrics, report_tables


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
