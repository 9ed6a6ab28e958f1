"""Cells that are worse than in earlier runs: only where the interval says so, and worse than in all of them."""

from __future__ import annotations

import pytest

from benchmarks.pipeline.compare_tables import compare, direction
from pipeline.tables import Cell, Table


def run(**cells: Cell) -> dict[str, Table]:
    return {"trials": {"bca": {"n": 50, **cells}}}


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ("success_pct", 1), ("bca_success_pct", 1), ("force_n", -1), ("tip_px", -1), ("mse_n2", -1),
        ("interval_pct", 0), ("image_px", 0), ("minutes", 0), ("success_low_pct", 0),
    ],
)  # fmt: skip
def test_what_is_better(column: str, expected: int) -> None:
    assert direction(column) == expected


def test_cells_beyond_their_interval_are_told() -> None:
    earlier = run(success_pct=98.0, force_n=[0.05, 0.02], mse_n2=1.0, minutes=3.0, word="default")
    found = compare([earlier, run(success_pct=70.0, force_n=[0.03, 0.02], mse_n2=1.2, minutes=9.0)], 1.1)
    assert found.worse == ["trials | bca | success_pct: 98, now 70"]
    assert found.better == ["trials | bca | force_n: 0.0500 ± 0.0200, now 0.0300 ± 0.0200"]
    assert found.alone_worse == ["trials | bca | mse_n2: 1, now 1.2"]
    assert (found.compared, found.alone, found.missing) == (2, 1, [])
    within = compare([earlier, run(success_pct=90.0, force_n=[0.055, 0.02], mse_n2=1.05)], 1.1)
    assert not within.worse + within.better + within.alone_worse


def test_a_cell_has_to_be_worse_than_in_every_earlier_run() -> None:
    good, bad, new = (run(success_pct=share) for share in (98.0, 60.0, 70.0))
    assert compare([good, new], 1.1).worse
    assert not compare([good, bad, new], 1.1).worse
    assert compare([bad, good, run(success_pct=20.0)], 1.1).worse


def test_rows_that_have_gone_are_told() -> None:
    assert compare([run(success_pct=98.0), {}], 1.1).missing == ["trials | bca | success_pct"]
