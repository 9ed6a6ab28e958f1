"""Interruption: Ctrl-C, SIGTERM, SIGKILL and a full disk leave nothing half-written, and the next run goes on."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.store.manifest import read_manifest
from pipeline.store.run_folder import Identity, RunFolder
from tests.conftest import PipelineProcess
from tests.pipeline.waiting import wait_until

PHANTOMS = ("type_1", "type_2", "bovine")
STAGE = ("stage=phantoms", f"stage.phantoms=[{','.join(PHANTOMS)}]", "stage.resolution_mm=2.5", "stage.picture=false",
         "name=run")  # fmt: skip


def assert_every_file_is_whole(folder: Path) -> None:
    for path in folder.rglob("*.json"):
        if not path.name.startswith(".writing-"):
            json.loads(path.read_text())
    for path in folder.rglob("grid.npz"):
        with np.load(path) as grid:
            assert np.isfinite(grid["values"]).all()


def contents(folder: Path) -> dict[str, str]:
    manifest = read_manifest(folder)
    assert manifest is not None
    return {name: entry["sha256"] for name, entry in manifest.outputs.items()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the stage leaves when nothing stops it."""
    process = PipelineProcess(tmp_path_factory.mktemp("whole"))
    done = process.run_here(*STAGE)
    assert done.returncode == 0, done.stderr
    return contents(process.runs / "run" / "phantoms")


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_a_stopped_or_killed_stage_leaves_whole_files_and_goes_on(
    number: signal.Signals, code: int, pipeline_process, whole: dict[str, str]
) -> None:
    folder = pipeline_process.runs / "run" / "phantoms"
    process = pipeline_process.start(*STAGE)
    wait_until(lambda: any(folder.glob(".progress/item-*.json")), process)  # in the middle of the work
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in stderr
    if number == signal.SIGINT:
        assert stderr.strip().splitlines()[-1].startswith("interrupted: what is finished is kept")
    assert not (folder / "manifest.json").exists()
    assert number == signal.SIGKILL or not list(folder.rglob(".writing-*"))
    assert_every_file_is_whole(folder)

    done = pipeline_process.run_here(*STAGE)
    assert done.returncode == 0, done.stderr
    assert "finished items kept" in done.stdout
    assert not list(folder.rglob(".writing-*"))
    assert contents(folder) == whole


def test_ctrl_c_while_the_program_starts_is_one_sentence(pipeline_process) -> None:
    process = pipeline_process.start(*STAGE, interpreter_options=("-X", "importtime"))
    assert process.stderr is not None
    while "omegaconf" not in process.stderr.readline():  # the program's own imports are under way
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    said = [line for line in stderr.splitlines() if not line.startswith("import time:")]
    assert process.returncode == 130
    assert said == ["interrupted: what is finished is kept; the same command goes on from there"]
    assert not list(pipeline_process.runs.rglob("manifest.json"))


def test_a_second_run_of_the_same_folder_is_turned_away(pipeline_process) -> None:
    with RunFolder(pipeline_process.runs / "run" / "phantoms", Identity("c", {}, 1)).locked():
        second = pipeline_process.run_here(*STAGE)
    assert second.returncode == 2
    (line,) = second.stderr.strip().splitlines()
    assert "is in use by process" in line


def test_a_full_disk_is_one_sentence_and_leaves_nothing_half_written(pipeline_process) -> None:
    folder = pipeline_process.runs / "run" / "phantoms"
    # No file above 40 kB: the first mesh does not fit, as on a disk with that much left.
    process = pipeline_process.start(*STAGE, largest_file=40_000)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1
    (line,) = [line for line in stderr.strip().splitlines() if line]
    assert line.startswith("no room left")
    assert not (folder / "manifest.json").exists()
    assert not list(folder.rglob(".writing-*"))


def test_a_swallowed_ctrl_c_stops_the_work_after_the_item(tmp_path: Path, run_python) -> None:
    said = run_python(f"""
import os, signal
from pathlib import Path
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.store.interruption import let_ctrl_c_interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job comes without it
let_ctrl_c_interrupt()
folder = RunFolder(Path({str(tmp_path / "stage")!r}), Identity("c", {{}}, 1))
with folder.locked():
    folder.prepare()
    try:
        for item in folder.resumable(["a", "b", "c"]):
            try:
                if item == "b":
                    os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:
                pass  # as a library might
    except KeyboardInterrupt:
        print([item for item in "abc" if folder.result_of(item) is not None])
""")
    assert said.strip() == "['a', 'b']"


_LIBRARY = """
import os, signal, time
try:
    os.kill(os.getpid(), signal.{signal})
    time.sleep(0.1)
except BaseException:
    print("swallowed")
print("imported")
"""
_INTERRUPTED_IN = """
import os, signal, sys, time
sys.path.insert(0, {folder!r})
from pipeline.store.interruption import let_ctrl_c_interrupt, let_sigterm_exit, stop_if_interrupted
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job comes without it
let_ctrl_c_interrupt()
let_sigterm_exit()
class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.{signal})
        time.sleep(0.01)
try:
    {statement}
    stop_if_interrupted()
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize(("number", "words", "code"), [("SIGINT", ["interrupted"], 0), ("SIGTERM", [], 143)])
@pytest.mark.parametrize(
    ("statement", "before"), [("import some_library", ["swallowed", "imported"]), ("Finalised()", [])]
)
def test_a_signal_that_a_library_or_a_finaliser_swallows_stops_the_work_after_it(
    tmp_path: Path, statement: str, before: list[str], number: str, words: list[str], code: int
) -> None:
    (tmp_path / "some_library.py").write_text(_LIBRARY.format(signal=number))
    script = _INTERRUPTED_IN.format(folder=str(tmp_path), statement=statement, signal=number)
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (ran.stdout.split(), ran.stderr, ran.returncode) == ([*before, *words], "", code)


_POOL = """
import os, subprocess, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pipeline.store.interruption import end_with_parent

def stage():
    with subprocess.Popen(["sleep", "60"]) as process:
        try:  # the parent may be killed as soon as it is printed
            print(process.pid, flush=True)
            process.wait()
        except BaseException:
            process.terminate()
            raise

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(stage).result()
"""


def test_a_pools_process_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    (tmp_path / "pool.py").write_text(_POOL)
    with subprocess.Popen([sys.executable, tmp_path / "pool.py"], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        processes = [Path("/proc") / parent.stdout.readline().strip() for _ in ("its own", "what that runs")]
        assert all(process.is_dir() for process in processes)
        parent.kill()
        wait_until(lambda: not any(process.is_dir() for process in processes), seconds=20)  # none goes on alone
