"""Figures over run seeds: what counts, and Student's interval."""

from __future__ import annotations

import pytest

from pipeline.report.intervals import OverSeeds, over_seeds


def test_every_seed_counts_alike_and_settings_do_not() -> None:
    """Means 80, 90 and 100: 4.303 (t of 2 degrees) times 10 / sqrt(3) either way."""
    parts = {
        seed: {"t": {"r": {"success_pct": [mean, 40.0], "n": 30 * (seed + 1), "epochs": 20, "kind": "a"}}}
        for seed, mean in enumerate((80.0, 90.0, 100.0))
    }
    parts[2]["t"]["other"] = {"success_pct": 5.0}  # of one seed alone
    found = over_seeds(parts)
    assert set(found) == {("t", "r", "success_pct")}
    one = found["t", "r", "success_pct"]
    assert (one.cell[0], one.seeds) == (90.0, 3)
    assert one.interval == (pytest.approx(90 - 24.84, abs=0.01), 100.0)  # a share is cut off
    assert OverSeeds(one.cell, 3).interval[1] == pytest.approx(90 + 24.84, abs=0.01)
    of_a_target = {seed: {"t": {"r": {"bca_success_pct": mean}}} for seed, mean in enumerate((80.0, 90.0, 100.0))}
    assert over_seeds(of_a_target)["t", "r", "bca_success_pct"].interval[1] == 100.0


def test_one_seed_has_no_interval() -> None:
    assert over_seeds({0: {"t": {"r": {"c": 1.0}}}}) == over_seeds({}) == {}
    with pytest.raises(ValueError, match="needs two of them, got 1"):
        _ = OverSeeds([1.0, 0.0], 1).interval
