"""Headlines: verdicts by the interval of the difference, and cells that exist."""

from __future__ import annotations

import pytest

from pipeline.report.headlines import (
    BETTER,
    EQUAL,
    OPEN,
    UNLIKE,
    WORSE,
    compare,
    headline_specs,
    headlines,
)
from pipeline.report.intervals import OverSeeds, difference_of_shares, mean_interval, share_interval
from pipeline.report.tables import report_tables


def test_shares_are_compared_by_newcombe_s_interval() -> None:
    """56 of 70 against 48 of 80: Newcombe's paper gives 0.0524 to 0.3339 for the difference."""
    low, high = difference_of_shares(80.0, 70, 60.0, 80)
    assert (low, high) == (pytest.approx(5.24, abs=0.01), pytest.approx(33.39, abs=0.01))
    shares = {"thesis_samples": 80, "samples": 70, "share": True}
    assert compare(60.0, 80.0, **shares) == BETTER
    assert compare(60.0, 80.0, **shares, higher_is_better=False) == WORSE
    assert compare(60.0, 66.0, **shares) == EQUAL
    assert compare(100.0, 100.0, thesis_samples=30, samples=30, share=True) == EQUAL
    assert compare(60.0, 100.0, thesis_samples=30, samples=1, share=True) == OPEN


def test_means_are_compared_by_welch_s_interval() -> None:
    many = {"thesis_samples": 30, "samples": 30, "higher_is_better": False}
    assert compare([36.9, 2.4], [30.0, 3.0], **many) == BETTER
    assert compare([36.9, 2.4], [45.0, 3.0], **many) == WORSE
    assert compare([36.9, 2.4], [37.5, 3.0], **many) == EQUAL
    assert compare([36.9, 2.4], [30.0, 0.0], thesis_samples=30, samples=1, higher_is_better=False) == OPEN
    exact = {"thesis_samples": None, "samples": 4, "higher_is_better": False}
    assert compare([2.88, 0.64], [0.1, 0.05], **exact) == BETTER
    assert compare([2.88, 0.64], [2.9, 1.0], **exact) == EQUAL


def test_numbers_are_equal_when_they_print_alike_and_p_values_on_the_same_side() -> None:
    alone = {"thesis_samples": None, "samples": None}
    assert compare(95.06, 95.064, decimals=2, **alone) == EQUAL
    assert compare(95.06, 95.10, decimals=2, **alone) == BETTER
    assert compare(0.445, 0.06, level=0.05, **alone) == EQUAL
    assert compare(0.445, 0.01, level=0.05, **alone) == WORSE


def test_intervals_of_known_cases() -> None:
    low, high = share_interval(50.0, 20) or (0, 0)
    assert (low, high) == (pytest.approx(29.93, abs=0.01), pytest.approx(70.07, abs=0.01))  # Wilson, 10 of 20
    low, high = mean_interval([10.0, 3.0], 10) or (0, 0)
    assert high - 10 == pytest.approx(2.2622, abs=1e-3)  # t of 9 degrees, 2.2622, times 3 / sqrt(9)
    assert mean_interval([1.0, 0.1], 1) is mean_interval(1.0, 30) is share_interval(50.0, None) is None


def test_every_headline_is_a_cell_of_the_thesis() -> None:
    lines = headlines(report_tables({}))
    assert len(lines) == len(headline_specs()) >= 15
    assert all(line.thesis and not line.here and not line.verdict for line in lines)


def test_a_measured_cell_stands_beside_the_thesis_s() -> None:
    measured = {
        "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 30}},
        "force_prediction_mse": {"baseline": {"mse_n2": 0.02}, "fpn_100k": {"mse_n2": 0.001}},
    }
    lines = {line.label: line for line in headlines(report_tables(measured)) if line.here}
    success = lines["Expert Navigation Network, BCA: success"]
    assert (success.thesis, success.here, success.interval) == ("100 %", "90 %", "74 to 97 %")
    assert (success.samples, success.verdict, success.chapter) == (30, UNLIKE, "ENN")
    assert "demonstrations" in success.differs
    error = next(line for label, line in lines.items() if label.startswith("Force prediction"))
    assert (error.thesis, error.here, error.verdict) == ("1.8 %", "5.0 %", UNLIKE)
    assert len(lines) == 2


def test_over_several_seeds_the_interval_is_that_of_the_seeds() -> None:
    """Success 90 % of 90 pooled episodes, but 80, 90 and 100 % of the three seeds; an error of 2, 3 and 4 mm."""
    clicks = ("guide3d_simulated_ways_mm", "global, clicks", "max_ed")
    measured = {
        "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 90}},
        clicks[0]: {clicks[1]: {clicks[2]: [3.0, 0.1], "n": 90}},
    }
    seeded = {
        ("ablation", "bca/I+V+M", "success_pct"): OverSeeds([90.0, 8.165], 3, is_share=True),
        clicks: OverSeeds([3.0, 0.8165], 3),
    }
    lines = {line.label: line for line in headlines(report_tables(measured, seeded)) if line.here}
    success = lines["Expert Navigation Network, BCA: success"]
    assert (success.interval, success.samples, success.seeds) == ("65 to 100 %", 3, 3)
    error = lines["Reconstruction of simulated wires: largest error"]
    assert (error.samples, error.seeds, error.verdict) == (3, 3, EQUAL)


def test_only_what_is_comparable_has_a_verdict_and_another_cell_may_be_the_measured_one() -> None:
    measured = {
        "guide3d_simulated_validation_mm": {"max_ed": {"value": [0.01, 0.01], "n": 60}},
        "guide3d_simulated_ways_mm": {"global, clicks": {"max_ed": [1.2, 0.3], "n": 60}},
        "segmentation": {"transunet": {"dice": 97.0}},
    }
    lines = {line.table: line for line in headlines(report_tables(measured)) if line.here}
    clicked = lines["guide3d_simulated_validation_mm"]
    assert (clicked.here, clicked.samples, clicked.verdict) == ("1.200 ± 0.300 mm", 60, BETTER)
    assert lines["segmentation"].verdict == UNLIKE
    assert all(spec.differs for spec in headline_specs())
