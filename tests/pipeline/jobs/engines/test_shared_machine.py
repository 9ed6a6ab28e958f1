"""A machine that stages share: a job a core, no more memory than there is, locks that end with their process."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.jobs.engines.shared_machine import FOLDER, Core, SharedMachine, shared_machine
from pipeline.jobs.gpus import Gpu

GB = 1_000_000_000


def test_there_are_as_many_jobs_as_cores() -> None:
    with shared_machine(2, 8.0):
        one, other = SharedMachine.of_environment(), SharedMachine.of_environment()
        assert one is not None
        assert other is not None
        first, second = one.take(1.0), other.take(1.0)
        assert first is not None
        assert second is not None
        assert one.take(0.1) is None
        second.free()
        third = one.take(0.1)
        assert third is not None
    assert SharedMachine.of_environment() is None


def test_jobs_of_all_stages_share_the_memory() -> None:
    with shared_machine(3, 4.0):
        cores = SharedMachine.of_environment()
        assert cores is not None
        assert cores.room_gb == 4.0
        large = cores.take(3.0)
        assert large is not None
        assert cores.take(1.5) is None
        small = cores.take(1.0)
        assert small is not None
        large.free()
        again = cores.take(2.9)
        assert again is not None


def test_a_core_is_free_when_its_stage_was_killed() -> None:
    hold = (
        "import sys, time\n"
        "from pipeline.jobs.engines.shared_machine import SharedMachine\n"
        "core = SharedMachine.of_environment().take(0.5)\n"
        "print('taken', flush=True)\n"
        "time.sleep(60)\n"
    )
    with shared_machine(1, 1.0):
        cores = SharedMachine.of_environment()
        assert cores is not None
        with subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "taken\n"
            assert cores.take(0.1) is None
            process.kill()
        assert cores.take(0.1) is not None


def test_a_folder_that_is_gone_means_no_sharing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "gone"))
    assert SharedMachine.of_environment() is None
    with shared_machine(1, 1.0):
        folder = Path(os.environ[FOLDER])
        assert folder.is_dir()
    assert not folder.exists()


def test_a_stage_without_a_job_comes_before_one_that_has_some(monkeypatch: pytest.MonkeyPatch) -> None:
    with shared_machine(2, 8.0):
        folder = Path(os.environ[FOLDER])
        one, other = SharedMachine(folder), SharedMachine(folder)

        def take(stage: int, memory_gb: float) -> Core | None:
            monkeypatch.setattr(os, "getpid", lambda: stage)
            machine = one if stage == 1 else other
            with machine.turn():
                return machine.take(memory_gb)

        first, second = take(1, 1.0), take(1, 1.0)
        assert first is not None
        assert second is not None
        assert take(2, 3.0) is None
        first.free()
        assert take(1, 1.0) is None  # the other one is due
        third = take(2, 3.0)
        assert third is not None
        second.free()
        fourth = take(1, 1.0)
        assert fourth is not None  # one each: nobody waits
        # a stage whose job has no memory waits for no core
        assert take(2, 7.0) is None
        third.free()
        assert take(2, 7.5) is None
        fifth = take(1, 1.0)
        assert fifth is not None
        # one that has ended is not waited for
        assert take(2, 1.0) is None
        assert list(folder.glob("waiting-*")) == [folder / "waiting-2"]
        assert other._waits is not None
        other._waits.close()
        fifth.free()
        assert take(1, 1.0) is not None


def gpu(visible: str, free_gb: int) -> Gpu:
    return Gpu(visible, "drawn", free_gb * GB, 24 * GB)


def test_gpus_are_looked_for_once_a_chain() -> None:
    looks = []

    def find() -> list[Gpu]:
        looks.append(1)
        return [gpu("0", 10), gpu("GPU-7f", 5)]

    with shared_machine(1, 1.0):
        found = [SharedMachine(Path(os.environ[FOLDER])).gpus(find) for _ in range(2)]
    assert found[0] == found[1] == find()
    assert len(looks) == 2  # one of them the last line's


def test_a_stage_sees_what_others_were_promised_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    with shared_machine(3, 8.0):
        machine = SharedMachine.of_environment()
        assert machine is not None
        with machine.turn():
            core, own = machine.take(1.0), machine.take(1.0)
        assert core is not None
        assert own is not None
        core.promise({"0": 3.0 * GB})
        with monkeypatch.context() as other_stage:
            other_stage.setattr(os, "getpid", lambda: -1)
            own.promise({"0": 2.0 * GB, "1": 1.0 * GB})
            assert machine.gpu_bytes_elsewhere() == {"0": 3.0 * GB}
            core.promise({"0": 1.0 * GB})  # as a job's growth is written again
            assert machine.gpu_bytes_elsewhere() == {}
        assert machine.gpu_bytes_elsewhere() == {"0": 3.0 * GB, "1": 1.0 * GB}
        core.free()
        own.free()
        assert machine.gpu_bytes_elsewhere() == {}


STAGE = """
import sys, time
from pathlib import Path
from pipeline.jobs.gpus import Gpu
from pipeline.jobs.pool import Job, run_jobs
from pipeline.store.run_folder import Identity, RunFolder

PLACE, NAME = Path(sys.argv[1]), sys.argv[2]

def hold(given, report):
    (PLACE / f"{report.device}-{NAME}-{given}").touch()
    while not (PLACE / "end").exists():
        time.sleep(0.02)
    return 1

if __name__ == "__main__":
    folder = RunFolder(PLACE / NAME, Identity("c", {}, 1))
    jobs = [Job(f"job{k}", hold, k, gpu_gb=6.0 * (k < 2)) for k in range(3)]
    with folder.locked():
        folder.prepare()
        run_jobs(folder, jobs, workers=3, device="cuda", find=lambda: [Gpu("0", "drawn", 13 * 10**9, 24 * 10**9)])
"""


def test_jobs_of_two_stages_share_a_gpu_by_its_memory(tmp_path: Path) -> None:
    """Two of four jobs of 6 GB have room on a GPU of 13 GB, from whichever stage; the job without a GPU starts."""
    file = tmp_path / "stage.py"
    file.write_text(STAGE, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])}
    with shared_machine(6, 8.0):
        environment[FOLDER] = os.environ[FOLDER]
        processes = [
            subprocess.Popen([sys.executable, str(file), str(tmp_path), name], env=environment)
            for name in ("one", "other")
        ]
        try:
            deadline = time.monotonic() + 120
            while len(list(tmp_path.glob("cpu-*"))) < 2 or len(list(tmp_path.glob("cuda-*"))) < 2:
                assert all(process.poll() is None for process in processes)
                assert time.monotonic() < deadline
                time.sleep(0.02)
            time.sleep(1.0)  # in which a third one would start
            assert len(list(tmp_path.glob("cuda-*"))) == 2
            (tmp_path / "end").touch()
            assert [process.wait(timeout=120) for process in processes] == [0, 0]
            assert len(list(tmp_path.glob("cuda-*"))) == 4
        finally:
            for process in processes:
                process.kill()
                process.wait()
