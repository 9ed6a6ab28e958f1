"""The contract between stages and report: what is refused where it is written; how sweeps are pooled."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline.tables import Figure, check_cell, pool, read_figures, write_figures, write_results


def test_a_cell_that_is_none_is_refused_where_it_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ablation / bca/H / force_n: expected a finite number"):
        write_results(tmp_path, {"ablation": {"bca/H": {"force_n": float("nan")}}})
    with pytest.raises(ValueError, match="a pair"):
        check_cell([1.0, 2.0, 3.0], "t / r / c")
    with pytest.raises(FileNotFoundError, match=r"figure 'a' names b\.png"):
        write_figures(tmp_path, [Figure("a", "", "b.png")])
    assert read_figures(tmp_path) == []


def test_pooling_equals_statistics_over_all_samples() -> None:
    values = [[1.0, 2.0, 6.0], [4.0, 4.0]]
    both = [x for part in values for x in part]

    def pair(samples: list[float]) -> list[float]:
        mean = sum(samples) / len(samples)
        return [mean, math.sqrt(sum((x - mean) ** 2 for x in samples) / len(samples))]

    cell, count = pool([(pair(part), len(part)) for part in values])
    assert cell == pytest.approx(pair(both))
    assert count == 5
    assert pool([(90.0, None), (100.0, None)]) == ([95.0, 5.0], 2)
    assert pool([(None, None), (3, 4)]) == (3, 4)
    assert pool([("a", None), ("a", None)]) == ("a", None)
