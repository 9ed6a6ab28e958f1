"""Evaluations: metrics of a log by hand, what counts and what does not."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline.evaluations.logs import (
    UnusableLogError,
    read_evaluation,
)
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_row


def test_metrics_come_from_the_arrays_with_the_thesis_reward(tmp_path: Path) -> None:
    (path,) = write_row(tmp_path, "enn", "V", successes=(True,), steps=4, force=0.3, way=0.2, contacts=3)
    one = read_evaluation(path, tmp_path)
    assert (one.stage, one.row, one.variant, one.mode, one.training_seed) == ("enn", "V", "desk", "deterministic", 0)
    assert (one.phantom, one.target, one.folder, one.success_radius) == ("type_1", "bca", "enn", 0.008)
    # distances 0.1, 0.076, 0.052, 0.028, 0.004 m: three steps pay for theirs, the last one earns 10
    assert one.metrics.reward == pytest.approx(10 - 0.076 - 0.052 - 0.028)
    assert one.metrics.path_length == pytest.approx(0.2)
    assert one.metrics.force_mean == one.metrics.force_max == pytest.approx(0.3)  # the state after reset is no step
    assert one.contact_force == pytest.approx(0.1)
    assert (one.metrics.steps, one.metrics.success) == (4, True)


def test_a_failed_episode_pays_for_every_step_and_has_no_contact_force_without_contacts(tmp_path: Path) -> None:
    (path,) = write_row(tmp_path, "enn", "V", successes=(False,), steps=2, contacts=0)
    one = read_evaluation(path, tmp_path)
    assert one.metrics.reward == pytest.approx(-0.065 - 0.03)
    assert one.contact_force is None


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"status": "interrupted"}, "its episode was broken off"),
        ({"end_distance": 0.02}, "claims success 20.0 mm from the target, the radius is 8 mm"),
        ({"outcome_success": False}, "its outcome says success=False, its last step True"),
        ({"mode": "greedy"}, "its mode is 'greedy', expected deterministic or stochastic"),
        ({"force": math.nan}, "force magnitudes must be finite"),
    ],
)
def test_logs_that_do_not_count_say_why(tmp_path: Path, arguments: dict, reason: str) -> None:
    metadata = {"row": "V", "mode": "deterministic", "training_seed": 0, **arguments}
    path = write_evaluation(tmp_path / "enn" / "000.mcap", **metadata)
    with pytest.raises(UnusableLogError, match=reason):
        read_evaluation(path, tmp_path)


def test_a_log_without_the_metadata_of_an_evaluation_is_none(tmp_path: Path) -> None:
    path = write_evaluation(tmp_path / "enn" / "000.mcap", row="V")
    with pytest.raises(UnusableLogError, match="its metadata lacks mode, training_seed"):
        read_evaluation(path, tmp_path)
