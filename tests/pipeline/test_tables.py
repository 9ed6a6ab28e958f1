"""The contract between stages and report: what is refused where it is written; how sweeps are pooled."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline.plots.words import column_words, group_words, in_words, place_in_thesis, row_words
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


def test_keys_in_words() -> None:
    labels = {"ppo_image": "PPO image"}
    assert row_words("ppo_image", labels) == "PPO image"
    assert row_words("ppo_image (thesis)", labels) == "PPO image (thesis)"
    assert row_words("fpn_10k", labels) == "FPN, 10k samples"
    assert row_words("fpn_16 V_plain", labels) == "FPN, 16 samples, V plain"
    assert row_words("some_new_row", labels) == "Some new row"
    assert group_words("type_1/bca/enn", {"type_1": "Type I arch", "bca": "BCA"}, {}) == "Type I arch, BCA, ENN"
    assert column_words("value_mm") == ("Value", "mm")
    assert column_words("mean_force") == ("Mean force", "")
    assert place_in_thesis("ch5-fig:reprojection-error") == "thesis, chapter 5, figure"
    assert place_in_thesis("app1tab:training-time") == "thesis, appendix 1, table"
    assert place_in_thesis("guide3d-tab:dataset-stats") == "thesis, chapter 5, table"
    assert in_words("Sampling expert, low_tortuosity, LCCA") == "Sampling expert, Low tortuosity, LCCA"
    assert in_words("0.5 N and/or 2 of 3, type_1/rcca") == "0.5 N and/or 2 of 3, Type I, RCCA"
