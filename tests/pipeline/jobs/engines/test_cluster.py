"""The engine of a cluster: results, progress, failures, lost machines, stops, a killed driver."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.jobs import pool
from pipeline.jobs.engines.cluster import JOBS, ClusterEngine, end_earlier_jobs
from pipeline.jobs.engines.settings import RaySettings
from pipeline.jobs.engines.task import Task, run_task
from pipeline.jobs.pool import Job, run_jobs
from pipeline.store.costs import kept_costs
from pipeline.store.errors import StageError
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.jobs.engines.process_executor import ProcessExecutor
from tests.pipeline.jobs.toy_training import Toy, square, train

Made = Callable[..., ProcessExecutor]


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / "stage", Identity("c", {}, 1))


@pytest.fixture
def on_cluster(monkeypatch: pytest.MonkeyPatch) -> Made:
    """Has jobs run on a cluster of processes."""

    def choose(*, retries: int = 2, **arguments: object) -> ProcessExecutor:
        cluster = ProcessExecutor(**arguments)

        def make(folder: RunFolder, *, workers: int, device: str, **unused: object) -> ClusterEngine:
            settings = RaySettings(retries=retries, lease_s=20.0)
            return ClusterEngine(folder, cluster, settings, device=device, at_once=workers)

        monkeypatch.setattr(pool, "make_engine", make)
        return cluster

    return choose


def test_jobs_on_a_cluster_leave_what_they_leave_on_one_machine(folder: RunFolder, on_cluster: Made, caplog) -> None:
    caplog.set_level(logging.INFO)
    cluster = on_cluster()
    with folder.locked():
        folder.prepare()
        jobs = [Job(name, train, Toy(folder.path / name)) for name in ("a", "b")]
        results = run_jobs(folder, [*jobs, Job("c", square, 7, after=("a", "b"))], label="toys")
        costs = kept_costs(folder.path)
        again = run_jobs(folder, [*jobs, Job("c", square, 8)], label="toys")
        folder.finish(stage="s", run="r", budget="b", seed=0, config={}, started=time.monotonic())
    assert results["c"] == 49
    assert {results["a"]["count"], results["b"]["count"]} == {3}
    assert {results["a"]["threads"], results["b"]["threads"]} == {"1"}
    assert again == results  # nothing was done twice
    assert len(cluster.tasks) == 3
    assert {key: cost["outcome"] for key, cost in costs.items()} == {"a": "ok", "b": "ok", "c": "ok"}
    assert any("toys 3/3" in record.getMessage() for record in caplog.records)
    assert cluster.closed
    assert not (folder.path / JOBS).exists()


def test_a_failing_or_killed_job_stops_no_other_and_is_not_done_again(
    folder: RunFolder, on_cluster: Made, tmp_path: Path, caplog
) -> None:
    cluster = on_cluster()
    jobs = [
        Job("error", train, Toy(tmp_path / "error", fails="error")),
        Job("sentence", train, Toy(tmp_path / "sentence", fails="sentence")),
        Job("kill", train, Toy(tmp_path / "kill", fails="kill")),
        Job("good", train, Toy(tmp_path / "good")),
        Job("after", square, 2, after=("error",)),
    ]
    with folder.locked():
        folder.prepare()
        with pytest.raises(StageError, match="4 of 5 toys failed") as raised:
            run_jobs(folder, jobs, label="toys")
    for words in (
        "error (ZeroDivisionError: a toy's trouble)", "sentence (the toy is broken: mend it)",
        "kill (its process was killed by signal 9)", "after (it needs error)",
    ):  # fmt: skip
        assert words in str(raised.value)
    assert folder.result_of("good")["count"] == 3
    assert "in train" in caplog.text
    assert len(cluster.tasks) == 4


def wait_for_file(path: Path) -> None:
    deadline = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("retries", [1, 0])
def test_a_job_whose_machine_is_lost_goes_on_elsewhere(
    retries: int, folder: RunFolder, on_cluster: Made, monkeypatch: pytest.MonkeyPatch, caplog
) -> None:
    cluster = on_cluster(retries=retries)
    submit = cluster.submit
    toy = Toy(folder.path / "a", steps=6, seconds_a_step=0.2)

    def submit_and_lose(*arguments: object) -> int:
        handle = submit(*arguments)
        if handle == 0:
            wait_for_file(toy.folder / "checkpoint.json")
            cluster.lose(handle)
        return handle

    monkeypatch.setattr(cluster, "submit", submit_and_lose)
    with folder.locked():
        folder.prepare()
        if retries:
            result = run_jobs(folder, [Job("a", train, toy)])["a"]
            assert result["count"] == 6
            assert result["began"] >= 1  # at the checkpoint of the lost machine
            assert "a: lost (what started it is gone); it is done again, time 2 of 2" in caplog.text
        else:
            with pytest.raises(StageError, match=r"a \(it was lost 1 times, at last because what started it is gone\)"):
                run_jobs(folder, [Job("a", train, toy)])
    assert len(cluster.tasks) == 1 + retries


def test_a_stopped_stage_lets_its_jobs_write_their_checkpoints(
    folder: RunFolder, on_cluster: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster = on_cluster(machines=1)
    toy = Toy(folder.path / "a", steps=400, seconds_a_step=0.05, checkpoint_every=1000)

    looks = []

    def interrupt() -> None:
        if (toy.folder / "started").exists() and list((folder.path / JOBS).glob("*/messages.jsonl")):
            looks.append(time.monotonic())
            if len(looks) > 8:  # the driver has read by now that the job has started; others are only dropped
                raise KeyboardInterrupt

    monkeypatch.setattr(pool, "stop_if_interrupted", interrupt)
    with folder.locked():
        folder.prepare()
        with pytest.raises(KeyboardInterrupt):
            run_jobs(folder, [Job("a", train, toy), Job("waits", train, Toy(folder.path / "waits"))])
    assert 0 <= json.loads((toy.folder / "checkpoint.json").read_text()) < 400
    assert not (folder.path / "waits").exists()
    assert cluster.closed


def test_a_new_driver_ends_the_jobs_of_one_that_is_gone(folder: RunFolder, tmp_path: Path) -> None:
    cluster = ProcessExecutor()
    toy = Toy(tmp_path / "toy", steps=10_000, seconds_a_step=0.01)
    with folder.locked():
        folder.prepare()
        engine = ClusterEngine(folder, cluster, RaySettings(lease_s=30.0))
        job = Job("a", train, toy)
        assert engine.submit(job)
        wait_for_file(toy.folder / "checkpoint.json")
        engine._driver.close()  # as if it had been killed; its job works on
        began = time.monotonic()
        end_earlier_jobs(folder.path)
        assert time.monotonic() - began < 25  # at once, not when the lease is over
        left = (toy.folder / "checkpoint.json").read_text()
        time.sleep(0.3)
        assert (toy.folder / "checkpoint.json").read_text() == left
        assert "another driver works in its folder" in next((folder.path / JOBS).glob("*/messages.jsonl")).read_text()
    cluster.close()


def test_a_job_without_a_sign_of_its_driver_ends(folder: RunFolder, tmp_path: Path) -> None:
    cluster = ProcessExecutor()
    toy = Toy(tmp_path / "toy", steps=10_000, seconds_a_step=0.01)
    with folder.locked():
        folder.prepare()
        engine = ClusterEngine(folder, cluster, RaySettings(lease_s=5.0))
        job = Job("a", train, toy)
        engine.submit(job)
        wait_for_file(toy.folder / "checkpoint.json")
        engine._driver.close()
        cluster.processes[0].join(60)
        assert cluster.processes[0].exitcode == 0
        text = next((folder.path / JOBS).glob("*/messages.jsonl")).read_text()
        assert "no sign of its driver for 5 s" in text
    cluster.close()


def test_what_no_machine_can_do_is_refused(folder: RunFolder, on_cluster: Made) -> None:
    cluster = on_cluster(memory_gb=8.0)
    with folder.locked():
        folder.prepare()
        with pytest.raises(StageError, match=r"huge needs 1 CPU and 9.0 GB of memory, and no machine of the cluster"):
            run_jobs(folder, [Job("huge", square, 2, memory_gb=9.0)])
        with pytest.raises(StageError, match=r"stage\.device=cuda:1 names a GPU of one machine"):
            run_jobs(folder, [Job("a", square, 2)], device="cuda:1")
    assert not cluster.tasks


def test_needs_are_named(folder: RunFolder, on_cluster: Made) -> None:
    cluster = on_cluster(has_gpus=True)
    with folder.locked():
        folder.prepare()
        assert run_jobs(folder, [Job("a", square, 2, memory_gb=3.0, gpu_gb=1.0, cpus=2)], device="auto") == {"a": 4}
        assert run_jobs(folder, [Job("b", square, 3, gpu_gb=1.0)], device="cpu") == {"b": 9}
    assert [str(needs) for _, _, needs in cluster.tasks] == [
        "2 CPUs, 1 GPU and 3.0 GB of memory", "1 CPU and 2.0 GB of memory"
    ]  # fmt: skip


def test_a_machine_that_does_not_see_the_folder_is_named() -> None:
    reason = run_task(Task("/no/such/folder", "", 5.0, "/no/python", "/", {}, b""))
    assert reason is not None
    assert "does not see /no/such/folder: put the project, its environment and runs_dir on a file system" in reason
