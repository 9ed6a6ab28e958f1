"""Engines: a cluster's, Slurm's and this machine's, and how one is chosen."""

import json
import logging
import multiprocessing
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.jobs import pool
from pipeline.jobs.engines.cluster import ClusterEngine, Executor, Needs, end_earlier_jobs
from pipeline.jobs.engines.local import ctrl_c_held_back
from pipeline.jobs.engines.settings import JOBS, SETTINGS, RaySettings, SlurmSettings
from pipeline.jobs.engines.slurm import SlurmExecutor
from pipeline.jobs.engines.task import Task, run_task
from pipeline.jobs.pool import Job, chosen_engine, run_jobs
from pipeline.store.costs import kept_costs
from pipeline.store.errors import StageError
from pipeline.store.manifest import read_manifest
from pipeline.store.run_folder import RunFolder
from pipeline.store.variants import effective_overrides
from tests.pipeline.jobs.toy_training import Toy, square, train
from tests.pipeline.waiting import wait_until


class ProcessExecutor(Executor):
    """A cluster whose machines are processes of this one, which a test can kill; tasks beyond them wait."""

    def __init__(self, machines: int = 2, memory_gb: float = 8.0, has_gpus: bool = False) -> None:
        self.capacity, self.memory_gb, self.has_gpus = machines, memory_gb, has_gpus
        self.tasks: list[tuple[str, Task, Needs]] = []
        self.processes: dict[int, Any] = {}
        self.cancelled: set[int] = set()
        self.closed = False

    def fits(self, needs: Needs) -> bool:
        return needs.memory_gb <= self.memory_gb

    def submit(self, name: str, task: Task, needs: Needs) -> int:
        self.tasks.append((name, task, needs))
        self._start()
        return len(self.tasks) - 1

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        for number, (_, task, _) in enumerate(self.tasks):
            running = sum(process.is_alive() for process in self.processes.values())
            if number not in self.processes and number not in self.cancelled and running < self.capacity:
                process = context.Process(target=run_task, args=(task,))
                process.start()
                self.processes[number] = process

    def result(self, handle: int) -> str | None:
        self._start()
        if handle in self.cancelled:
            return "it was cancelled"
        process = self.processes.get(handle)
        if process is None or process.is_alive():
            return None
        return "" if process.exitcode == 0 else f"machine {handle} does not answer"

    def lose(self, handle: int) -> None:
        """Kills a machine."""
        self.processes[handle].kill()
        self.processes[handle].join()

    def cancel(self, handle: int) -> None:
        self.cancelled.add(handle)
        if handle in self.processes:
            self.processes[handle].kill()

    def close(self) -> None:
        self.closed = True
        for process in self.processes.values():
            process.kill()
            process.join()


Made = Callable[..., ProcessExecutor]


@pytest.fixture
def on_cluster(monkeypatch: pytest.MonkeyPatch) -> Made:
    """Has jobs run on a cluster of processes."""

    def choose(*, retries: int = 2, **arguments: object) -> ProcessExecutor:
        cluster = ProcessExecutor(**arguments)

        def make(folder: RunFolder, *, workers: int, device: str, **unused: object) -> ClusterEngine:
            return ClusterEngine(folder, cluster, RaySettings(retries=retries), device=device, at_once=workers)

        monkeypatch.setattr(pool, "make_engine", make)
        return cluster

    return choose


def test_jobs_on_a_cluster_leave_what_they_leave_on_one_machine(folder: RunFolder, on_cluster: Made, caplog) -> None:
    caplog.set_level(logging.INFO)
    cluster = on_cluster()
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
    cluster = on_cluster(retries=0)
    jobs = [
        Job("error", train, Toy(tmp_path / "error", fails="error")),
        Job("kill", train, Toy(tmp_path / "kill", fails="kill")),
        Job("good", train, Toy(tmp_path / "good")),
        Job("after", square, 2, after=("error",)),
    ]
    with pytest.raises(StageError, match="3 of 4 toys failed") as raised:
        run_jobs(folder, jobs, label="toys")
    for words in (
        "error (ZeroDivisionError: a toy's trouble)",
        "kill (it was lost 1 times, at last because machine 1",
    ):
        assert words in str(raised.value)
    assert "after (it needs error)" in str(raised.value)
    assert folder.result_of("good")["count"] == 3
    assert "in train" in caplog.text
    assert len(cluster.tasks) == 3


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
            wait_until((toy.folder / "checkpoint.json").exists)
            cluster.lose(handle)
        return handle

    monkeypatch.setattr(cluster, "submit", submit_and_lose)
    if retries:
        result = run_jobs(folder, [Job("a", train, toy)])["a"]
        assert result["count"] == 6
        assert result["began"] >= 1  # at the checkpoint of the lost machine
        assert "a: lost (machine 0 does not answer); it is done again, time 2 of 2" in caplog.text
    else:
        with pytest.raises(StageError, match=r"a \(it was lost 1 times, at last because machine 0 does not answer\)"):
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
    with pytest.raises(KeyboardInterrupt):
        run_jobs(folder, [Job("a", train, toy), Job("waits", train, Toy(folder.path / "waits"))])
    assert 0 <= json.loads((toy.folder / "checkpoint.json").read_text()) < 400
    assert not (folder.path / "waits").exists()
    assert cluster.closed


def left_alone(folder: RunFolder) -> ProcessExecutor:
    """Starts a job without an end, whose driver then goes as if it had been killed."""
    cluster, toy = ProcessExecutor(), Toy(folder.path / "a", steps=10_000, seconds_a_step=0.01)
    assert ClusterEngine(folder, cluster, RaySettings()).submit(Job("a", train, toy))
    wait_until((toy.folder / "checkpoint.json").exists)
    return cluster


def messages(folder: RunFolder) -> str:
    return next((folder.path / JOBS).glob("*/messages.jsonl")).read_text()


def test_a_new_driver_ends_the_jobs_of_one_that_is_gone(folder: RunFolder) -> None:
    cluster = left_alone(folder)
    began = time.monotonic()
    end_earlier_jobs(folder.path)
    assert time.monotonic() - began < 25  # at once, not when the wait is over
    left = (folder.path / "a" / "checkpoint.json").read_text()
    time.sleep(0.3)
    assert (folder.path / "a" / "checkpoint.json").read_text() == left
    assert "no driver waits for it any more" in messages(folder)
    cluster.close()


def test_what_no_machine_can_do_is_refused(folder: RunFolder, on_cluster: Made) -> None:
    cluster = on_cluster(memory_gb=8.0)
    with pytest.raises(StageError, match=r"huge needs 1 CPU and 9.0 GB of memory, and no machine of the cluster"):
        run_jobs(folder, [Job("huge", square, 2, memory_gb=9.0)])
    with pytest.raises(StageError, match=r"stage\.device=cuda:1 names a GPU of one machine"):
        run_jobs(folder, [Job("a", square, 2)], device="cuda:1")
    assert not cluster.tasks


def test_needs_are_named(folder: RunFolder, on_cluster: Made) -> None:
    cluster = on_cluster(has_gpus=True)
    assert run_jobs(folder, [Job("a", square, 2, memory_gb=3.0, gpu_gb=1.0)], device="auto") == {"a": 4}
    assert run_jobs(folder, [Job("b", square, 3, gpu_gb=1.0)], device="cpu") == {"b": 9}
    assert [str(needs) for _, _, needs in cluster.tasks] == [
        "1 CPU, 1 GPU and 3.0 GB of memory", "1 CPU and 2.0 GB of memory"
    ]  # fmt: skip


def test_a_machine_that_does_not_see_the_folder_is_named() -> None:
    reason = run_task(Task("/no/such/folder", "/", (), {}, False, b""))
    assert reason is not None
    assert "does not see /no/such/folder" in reason


def test_jobs_by_submitit_leave_their_results_and_fail_with_a_sentence(folder: RunFolder, tmp_path: Path) -> None:
    toys = [Job("good", train, Toy(tmp_path / "good")), Job("bad", train, Toy(tmp_path / "bad", fails="sentence"))]
    with chosen_engine(SlurmSettings(manager="local", jobs=2)):
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
    cluster._executor.update_parameters(**cluster.parameters("enn type_1/bca", Needs(1, 4.0)))
    script = _make_sbatch_string(command="true", folder=tmp_path, **cluster._executor._executor.parameters)
    for line in (
        "--job-name=enn_type_1_bca", "--time=90", "--cpus-per-task=1", "--gpus-per-node=1", "--mem=4GB",
        "--partition=long", "--account=lab", "--no-requeue",
    ):  # fmt: skip
        assert f"#SBATCH {line}\n" in script


_INTERRUPT_ITSELF = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
_INTERRUPTED_MEANWHILE = """
import os, signal
from pipeline.jobs.engines.local import ctrl_c_held_back

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job comes without it
try:
    with ctrl_c_held_back():
        os.kill(os.getpid(), signal.SIGINT)
        print("held back")
except KeyboardInterrupt:
    print("interrupted", signal.pthread_sigmask(signal.SIG_BLOCK, ()))
"""


def test_a_ctrl_c_while_processes_start_is_not_lost() -> None:
    process = subprocess.run([sys.executable, "-c", _INTERRUPTED_MEANWHILE], capture_output=True, text=True, check=True)
    assert process.stdout == "held back\ninterrupted set()\n"


def test_what_is_started_does_not_see_it() -> None:
    with ctrl_c_held_back():
        process = subprocess.run([sys.executable, "-c", _INTERRUPT_ITSELF], capture_output=True, text=True, check=False)
    assert (process.stdout, process.stderr, process.returncode) == ("alive\n", "", 0)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["engine=rai"], "unknown engine 'rai': choose one of local, ray, slurm"),
        (["engine=ray", "engine.retrys=3"], "unknown setting 'engine.retrys': did you mean engine.retries?"),
        (["engine.retries=1"], "unknown setting 'engine.retries': engine=local has none"),
        (["engine=slurm", "engine.manager=pbs"], "engine.manager has no 'pbs'"),
    ],
)
def test_what_is_no_engine_is_refused(overrides: list[str], words: str, pipeline_process) -> None:
    done = pipeline_process.run_here("stage=report", "budget=smoke", "name=run", *overrides)
    assert done.returncode == 2
    assert done.stderr.startswith(words)
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_engine_is_no_part_of_the_result(pipeline_process) -> None:
    assert effective_overrides(["engine=ray", "engine.retries=3", "seed=1"]) == ["seed=1"]
    for engine in SETTINGS:
        done = pipeline_process.run_here("stage=report", "budget=smoke", "name=run", f"engine={engine}")
        assert done.returncode == 0, done.stderr
        assert ("up to date" in done.stderr + done.stdout) == (engine != "local")
    manifest = read_manifest(pipeline_process.runs / "run" / "report")
    assert manifest is not None
    assert manifest.variant == []
