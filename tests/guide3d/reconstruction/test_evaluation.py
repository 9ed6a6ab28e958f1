"""Evaluation of reconstructions: records of pairs, and their summaries."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.reconstruction.evaluation import (
    METRICS,
    PLACES,
    accepted,
    evaluate_pair,
    profile_summary,
    reprojection_summary,
    truth_summary,
)
from guide3d.reconstruction.synthetic_scene import scenes


@pytest.fixture(scope="module")
def scene():
    return next(iter(scenes(1, seed=0, noise_px=0.0)))


@pytest.mark.parametrize("greedy", [False, True])
def test_a_record_holds_the_errors_in_the_images_and_of_the_truth(scene, greedy: bool) -> None:
    record = evaluate_pair(*scene.cameras, *scene.points, scene.curve_mm, greedy=greedy)
    assert record["accepted"]
    assert max(record["mean_a_px"], record["mean_b_px"]) < (3.0 if greedy else 0.3)
    assert len(record["along_a_px"]) == len(record["along_mm"]) == PLACES
    assert np.mean(record["along_mm"]) == pytest.approx(record["mers"], abs=0.3)
    assert abs(record["length_error_mm"]) < 5.0
    assert set(record["curve"]) == {"tck", "u"}
    summary = truth_summary([record, record])
    assert summary["mers"] == [pytest.approx(record["mers"]), 0.0]
    assert set(summary) == {*METRICS, "length_error", "n"}
    assert "mers" not in evaluate_pair(*scene.cameras, *scene.points, greedy=greedy)


def test_a_pair_with_nothing_in_common_is_a_record_with_the_reason(scene) -> None:
    away = [scene.points[0], scene.points[1] * [0.0, 0.05] + [3.0, 0.0]]
    record = evaluate_pair(*scene.cameras, *away, greedy=True)
    assert not record["accepted"]
    assert "in common" in record["reason"]
    good = evaluate_pair(*scene.cameras, *scene.points, greedy=True)
    assert accepted([record, good]) == [good]
    assert reprojection_summary([record]) == {"accepted_pct": 0.0, "n": 1}
    both = reprojection_summary([record, good])
    assert both["accepted_pct"] == 50.0
    assert both["mean_a"] == [good["mean_a_px"], 0.0]


def test_a_profile_is_summed_up_at_the_tip_the_peak_and_the_ends() -> None:
    summary = profile_summary([[1.0, 5.0, 2.0], [3.0, 5.0, 2.0]])
    assert summary == {"distal_mean": 2.0, "peak_mean": 5.0, "std_start": 1.0, "std_end": 0.0, "n": 2}
