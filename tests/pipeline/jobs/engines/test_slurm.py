"""Slurm's engine, by the processes that submitit starts in its place, and what a job is submitted with."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pipeline.jobs.engines.cluster import Needs
from pipeline.jobs.engines.settings import SlurmSettings
from pipeline.jobs.engines.slurm import SlurmExecutor
from pipeline.jobs.pool import Job, chosen_engine, run_jobs
from pipeline.store.errors import StageError
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.jobs.toy_training import Toy, square, train


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / "stage", Identity("c", {}, 1))


def test_jobs_by_submitit_leave_their_results_and_fail_with_a_sentence(folder: RunFolder, tmp_path: Path) -> None:
    toys = [Job("good", train, Toy(tmp_path / "good")), Job("bad", train, Toy(tmp_path / "bad", fails="sentence"))]
    with folder.locked(), chosen_engine(SlurmSettings(manager="local", jobs=2)):
        folder.prepare()
        with pytest.raises(StageError, match=r"1 of 2 toys failed: bad \(the toy is broken: mend it\)"):
            run_jobs(folder, toys, label="toys")
        again = run_jobs(folder, [toys[0], Job("bad", square, 3)], label="toys")
    assert again["bad"] == 9
    assert again["good"]["count"] == 3


def test_where_there_is_no_slurm_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(StageError, match="there is no sbatch on this machine"):
        SlurmExecutor(SlurmSettings(), tmp_path)


def test_a_job_is_submitted_with_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from submitit.slurm.slurm import _make_sbatch_string

    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    settings = SlurmSettings(partition="long", account="lab", hours=1.5)
    cluster = SlurmExecutor(settings, tmp_path)
    cluster._executor.update_parameters(**cluster.parameters("enn type_1/bca", Needs(2, 1, 4.0)))
    script = _make_sbatch_string(command="true", folder=tmp_path, **cluster._executor._executor.parameters)
    for line in (
        "--job-name=enn_type_1_bca", "--time=90", "--cpus-per-task=2", "--gpus-per-node=1", "--mem=4GB",
        "--partition=long", "--account=lab", "--no-requeue",
    ):  # fmt: skip
        assert f"#SBATCH {line}\n" in script
