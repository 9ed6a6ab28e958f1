"""A machine that stages share: a job a core, no more memory than there is, nothing left of a stage that has ended."""

import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

from pipeline.jobs.machine import FOLDER, Gpu, Machine, shared_machine
from pipeline.jobs.pool import Job, run_jobs
from pipeline.store.run_folder import RunFolder
from tests.pipeline.jobs.toy_training import GB, SECONDS_BESIDE_OTHERS, gpu, overlap, square, where

ALIVE, ALSO_ALIVE = os.getpid(), os.getppid()  # owners of jobs must be processes that there are


def here(*gpus: Gpu) -> Machine:
    """The chain's machine, as one of its stages sees it."""
    with patch("pipeline.jobs.machine.find_gpus", lambda: gpus):
        return Machine.here(99, lambda: pytest.fail("the chain has counted"), "cuda" if gpus else "cpu")


def takes(machine: Machine, key: str, memory_gb: float, gpu_gb: float = 0.0) -> bool:
    return machine.take(Job(key, square, memory_gb=memory_gb, gpu_gb=gpu_gb)) is not None


def test_there_are_as_many_jobs_as_cores_and_no_more_memory_than_there_is() -> None:
    with shared_machine(3, 4.0):
        one, other = here(), here()
        assert one.available_gb == 4.0
        assert takes(one, "large", 3.0)
        assert not takes(other, "too large", 1.5)
        assert takes(other, "a", 0.5)
        assert takes(one, "b", 0.1)
        assert not takes(other, "c", 0.1)  # no core
        one.free("large")
        assert takes(one, "again", 2.9)
    assert FOLDER not in os.environ


def test_what_a_killed_stage_had_is_free() -> None:
    hold = (
        "import time\n"
        "from tests.pipeline.jobs.test_machine import here, takes\n"
        "print(takes(here(), 'a', 0.5), flush=True)\n"
        "time.sleep(60)\n"
    )
    with shared_machine(1, 1.0):
        with subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "True\n"
            assert not takes(here(), "b", 0.1)
            process.kill()
        assert takes(here(), "b", 0.1)


def test_a_folder_that_is_gone_means_no_sharing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "gone"))
    assert Machine.here(2, lambda: 3 * GB, "cpu").available_gb == 3.0
    with shared_machine(1, 1.0):
        folder = Path(os.environ[FOLDER])
        assert folder.is_dir()
    assert not folder.exists()


def test_a_stage_without_a_job_comes_before_one_that_has_some(monkeypatch: pytest.MonkeyPatch) -> None:
    with shared_machine(2, 8.0):
        machine = here()

        def act(stage: int, key: str, memory_gb: float) -> bool:
            monkeypatch.setattr(os, "getpid", lambda: stage)
            return takes(machine, key, memory_gb)

        def free(stage: int, key: str) -> None:
            monkeypatch.setattr(os, "getpid", lambda: stage)
            machine.free(key)

        one, other = ALIVE, ALSO_ALIVE
        assert act(one, "a", 1.0)
        assert act(one, "b", 1.0)
        assert not act(other, "c", 3.0)
        free(one, "a")
        assert not act(one, "a", 1.0)  # the other one is due
        assert act(other, "c", 3.0)
        free(one, "b")
        assert act(one, "b", 1.0)  # one each: nobody waits
        assert not act(other, "d", 7.0)  # a stage whose job has no memory waits for no core
        free(other, "c")
        assert not act(other, "c", 7.5)
        assert act(one, "a", 1.0)


def test_gpus_are_looked_for_once_a_chain() -> None:
    with shared_machine(1, 1.0):
        found = [here(gpu("0", 10), gpu("GPU-7f", 5)).gpus, here(gpu("1", 1)).gpus]
    assert found[0] == found[1] == [gpu("0", 10), gpu("GPU-7f", 5)]


def test_a_stage_sees_what_others_were_promised_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    with shared_machine(9, 8.0):
        machine = here(gpu("0", 10))
        assert takes(machine, "a", 0.0, 3.0)
        monkeypatch.setattr(os, "getpid", lambda: ALSO_ALIVE)
        assert not takes(machine, "b", 0.0, 8.0)
        machine.free("a")  # that of the other stage stays
        assert not takes(machine, "b", 0.0, 8.0)
        assert takes(machine, "b", 0.0, 7.0)


def test_jobs_share_a_gpu_with_those_of_another_stage(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two jobs of 6 GB have room on a GPU of 13 GB, and another stage has one there."""
    with shared_machine(6, 8.0):
        with monkeypatch.context() as patch:
            patch.setattr(os, "getpid", lambda: ALSO_ALIVE)
            assert takes(here(gpu("0", 13)), "another's", 0.0, 6.0)
        jobs = [Job(f"job{k}", where, SECONDS_BESIDE_OTHERS, gpu_gb=6.0) for k in range(2)]
        monkeypatch.setattr("pipeline.jobs.machine.find_gpus", lambda: [gpu("0", 13)])
        told = run_jobs(folder, jobs, workers=3, device="cuda")
    assert [one["visible"] for one in told.values()] == ["0", "0"]
    assert not overlap(*told.values())
