"""How long a rehearsal trains, at which rate and with how many threads."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from enn.device_trials import Tried
from enn.reinforcement.rehearsal_rules import in_share
from pipeline.stages.rehearsal.copies import RehearsalJob, training_settings
from pipeline.stages.rehearsal.training import first_turn
from pipeline.store.atomic_files import write_arrays
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, job_of


@pytest.mark.parametrize(("cores", "asked", "threads"), [(1, 0, 1), (2, 0, 2), (16, 0, 4), (2, 3, 3)])
def test_a_training_has_a_thread_for_each_core_within_reason(
    cores: int, asked: int, threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.stages.rehearsal.copies.available_workers", lambda: cores)
    assert training_settings(job_of(tmp_path, threads=asked), "cpu").threads == threads


@pytest.mark.parametrize(
    ("arrivals", "others", "trials", "decisions"),
    [
        ((True, True, True, False), (True, True), 0, 24),
        ((True, True, True, False), (True, True), 1, 24),
        ((True, True, True, False), (True, True), 2, 48),
        ((True, True, True, False), (True, False), 0, 48),
        ((True, True, True, True), None, 0, 48),
        ((True, True, False, False), None, 0, 48),
        ((True, True, True), None, 0, 48),
        ((), None, 0, 48),
    ],
    ids=[
        *("three of four", "and in the only trial", "but in one trial of two", "but not elsewhere", "all"),
        *("two of four", "one copy was not played", "none was played"),
    ],
)
def test_a_policy_that_mostly_arrives_is_trained_for_fewer_decisions(
    tmp_path: Path, arrivals: tuple[bool, ...], others: tuple[bool, ...] | None, trials: int, decisions: int
) -> None:
    tried = Tried(1, trials, 100.0, 0.1) if trials else None
    job = dataclasses.replace(job_of(tmp_path, copies=3, share_of_decisions=0.5), tried=tried)
    for copy, arrives in zip(job.training_cases, arrivals, strict=False):
        write_arrays(tmp_path / f"demonstrations/generalist_{copy}_0.npz", {"terminated": np.array(arrives)})
        write_arrays(tmp_path / f"demonstrations/navigator_{copy}_0.npz", {"terminated": np.array(True)})

    def elsewhere() -> Sequence[bool]:
        assert others is not None  # it is not played where the first round says enough
        return others

    assert not job.rules.mostly_arrives(first_turn(job), tried, elsewhere)  # of nothing
    fewer = job.rules.mostly_arrives(first_turn(dataclasses.replace(job, start=GENERALIST)), tried, elsewhere)
    training = training_settings(job, "cpu", fewer=fewer)
    assert (training.decisions, training.evaluate_every) == (decisions, decisions // 3)
    assert training.learning_rate * decisions == pytest.approx(48 * training_settings(job, "cpu").learning_rate)
    assert training_settings(job_of(tmp_path, algorithm="ppo"), "cpu", fewer=True).decisions == 48


def always_arrives(job: RehearsalJob) -> bool:
    return in_share(first_turn(job), job.tried, 1.0)


def test_a_policy_that_always_arrives_is_trained_until_the_last_evaluation_but_one(tmp_path: Path) -> None:
    job = dataclasses.replace(job_of(tmp_path, copies=3), start=GENERALIST)
    assert not always_arrives(job)  # nothing was played
    for copy in job.training_cases:
        write_arrays(tmp_path / f"demonstrations/generalist_{copy}_0.npz", {"terminated": np.array(True)})
    assert always_arrives(job)
    assert always_arrives(dataclasses.replace(job, tried=Tried(8, 8, 100.0, 0.1)))
    assert not always_arrives(dataclasses.replace(job, tried=Tried(7, 8, 100.0, 0.1)))
    assert not always_arrives(dataclasses.replace(job, start=None))
    usual, shorter = (
        training_settings(job, "cpu"),
        training_settings(job, "cpu", evaluations=job.rules.fewer_evaluations),
    )
    assert (usual.decisions, shorter.decisions) == (48, 32)
    assert usual.evaluate_every == shorter.evaluate_every == 16
    assert usual.learning_rate == shorter.learning_rate
    write_arrays(
        tmp_path / f"demonstrations/generalist_{job.training_cases[-1]}_0.npz", {"terminated": np.array(False)}
    )
    assert not always_arrives(job)
