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


LABELS = {"I+V+M": "I+V+M (ENN)", "ppo_image": "PPO image"}


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("ppo_image", "PPO image"), ("fpn_200", "FPN, 200 samples"), ("fpn_10k", "FPN, 10k samples"),
        ("fpn_16 V_plain", "FPN, 16 samples, V plain"), ("image_w_enn_100", "Image with ENN, 100 episodes"),
        ("I+V+M safe 0.5", "I+V+M, safe, cost of a newton 0.5"), ("ppo_image (thesis)", "PPO image (thesis)"),
        ("some_new_row", "Some new row"), ("sampling_expert", "Sampling expert"),
    ],
)  # fmt: skip
def test_rows_in_words(key: str, words: str) -> None:
    assert row_words(key, LABELS) == words


def test_groups_and_columns_in_words() -> None:
    assert group_words("type_1/bca/enn", {"type_1": "Type I arch", "bca": "BCA"}, {}) == "Type I arch, BCA, ENN"
    assert group_words("", {}, {}) == ""
    assert column_words("value_mm") == ("Value", "mm")
    assert column_words("mean_force") == ("Mean force", "")


@pytest.mark.parametrize(
    ("label", "words"),
    [
        ("ch3tab:cathsim_initial_results", "thesis, chapter 3, table"),
        ("ch5-fig:reprojection-error", "thesis, chapter 5, figure"),
        ("app1tab:training-time", "thesis, appendix 1, table"),
        ("guide3d-tab:dataset-stats", "thesis, chapter 5, table"),
        ("section Setup", "thesis, section Setup"), ("not in the thesis", "not in the thesis"),
    ],
)  # fmt: skip
def test_places_in_the_thesis(label: str, words: str) -> None:
    assert place_in_thesis(label) == words


def test_sentences_keep_all_but_their_keys() -> None:
    assert in_words("type_1/bca: shortest path") == "Type I, BCA: shortest path"
    assert in_words("Sampling expert, low_tortuosity, LCCA") == "Sampling expert, Low tortuosity, LCCA"
    assert in_words("0.5 N and/or 2 of 3, V+M/16") == "0.5 N and/or 2 of 3, V+M/16"
    assert in_words("type_1/rcca") == "Type I, RCCA"
    assert in_words("V_plain/16") == "V, force alone, 16"
