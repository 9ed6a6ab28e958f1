"""Run folders: up-to-date check, resuming, locking and what is removed when things change."""

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

from pipeline.store import manifest
from pipeline.store.atomic_files import write_json, write_text
from pipeline.store.errors import StageError
from pipeline.store.manifest import Identity, Manifest, files_below, read_manifest
from pipeline.store.provenance import hash_file, present_commit, software_versions
from pipeline.store.run_folder import RunFolder

IDENTITY = Identity("config", {"phantoms": "inputs"}, 1)


def finish(folder: RunFolder) -> Manifest:
    return folder.finish(
        stage="phantoms", run="r", budget="smoke", seed=0, config={"a": 1}, started=time.monotonic() - 2.0
    )


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / "phantoms", IDENTITY)


def build(folder: RunFolder, names: str = "abc") -> list[str]:
    built = []
    with folder.locked():
        folder.prepare()
        for name in folder.resumable(list(names)):
            (folder.path / f"{name}.txt").write_text(name)
            built.append(name)
    return built


def test_finished_folder_is_up_to_date_and_its_manifest_round_trips(folder: RunFolder) -> None:
    build(folder)
    assert not folder.is_up_to_date()
    written = finish(folder)
    assert folder.is_up_to_date()
    assert read_manifest(folder.path) == written
    content = json.loads((folder.path / "manifest.json").read_text())
    assert content["identity"]["input_hashes"] == {"phantoms": "inputs"}
    assert set(written.outputs) == {"a.txt", "b.txt", "c.txt"}
    assert written.outputs["a.txt"]["bytes"] == 1
    assert 2.0 <= written.wall_time_s < 10
    assert not (folder.path / ".progress").exists()


@pytest.mark.parametrize("changed", [{"config_hash": "other"}, {"input_hashes": {"phantoms": "b"}}, {"version": 2}])
def test_a_change_puts_the_folder_out_of_date_and_moves_it_aside(folder: RunFolder, changed: Any, caplog) -> None:
    build(folder)
    earlier = finish(folder)
    later = RunFolder(folder.path, replace(IDENTITY, **changed))
    assert not later.is_up_to_date()
    assert build(later, "x") == ["x"]
    assert set(finish(later).outputs) == {"x.txt"}
    (aside,) = (folder.path.parent / ".old").iterdir()
    assert str(aside) in caplog.text
    assert read_manifest(aside) == earlier
    assert [(aside / f"{name}.txt").read_text() for name in "abc"] == list("abc")


def test_results_of_another_commit_are_kept_and_named(folder: RunFolder, caplog, monkeypatch) -> None:
    monkeypatch.setattr("pipeline.store.run_folder.present_commit", lambda: "first")
    with folder.locked(), pytest.raises(KeyboardInterrupt):
        build_until_interrupted(folder, at="b")
    monkeypatch.setattr("pipeline.store.run_folder.present_commit", lambda: "second")
    again = RunFolder(folder.path, IDENTITY)
    assert build(again) == ["b", "c"]
    assert "the 1 finished items were made by commit first, the code is at second" in caplog.text
    assert finish(again).commits == ["first", "second"]
    assert again.is_up_to_date()


def test_a_missing_cut_or_changed_output_puts_the_folder_out_of_date(folder: RunFolder, caplog) -> None:
    build(folder)
    finish(folder)
    for content in ("", "B", None):  # "b" was written: the second has its size
        if content is None:
            (folder.path / "b.txt").unlink()
        else:
            (folder.path / "b.txt").write_text(content)
        caplog.clear()
        assert not RunFolder(folder.path, IDENTITY).is_up_to_date()
        wrong = "is missing" if content is None else "was changed"
        assert f"{folder.path / 'b.txt'} {wrong}, so the stage runs again" in caplog.text


def test_a_changed_output_is_made_again_and_a_foreign_file_is_named(folder: RunFolder, caplog) -> None:
    build(folder)
    first = finish(folder)
    (folder.path / "notes.md").write_text("nobody reads files with this ending")
    assert folder.is_up_to_date()
    assert not caplog.text
    (folder.path / "d.txt").write_text("a reader would take it for an output")
    assert folder.is_up_to_date()
    assert "d.txt was not written by this stage: move it away" in caplog.text
    (folder.path / "d.txt").unlink()
    (folder.path / "a.txt").write_text("A")
    assert build(folder) == ["a", "b", "c"]
    assert finish(folder).outputs_hash == first.outputs_hash


def test_an_unreadable_manifest_counts_as_not_run(folder: RunFolder) -> None:
    build(folder)
    finish(folder)
    for content in ("", "{", "[]", '{"version": 99}', '{"version": 1, "stage": "x"}'):
        (folder.path / "manifest.json").write_text(content)
        assert read_manifest(folder.path) is None
        assert not folder.is_up_to_date()


@pytest.mark.parametrize(
    "name",
    ["manifest.json", ".progress/item-*.json", "a.txt"],
)
def test_a_pipe_in_place_of_a_file_is_not_waited_for(folder: RunFolder, name: str) -> None:
    build(folder)
    if not name.startswith(".progress"):
        finish(folder)
        assert folder.is_up_to_date()
    for file in list(folder.path.glob(name)) or [folder.path / name]:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        os.mkfifo(file)
    again = RunFolder(folder.path, folder.identity)
    assert not again.is_up_to_date()
    build(again)
    finish(again)
    assert again.is_up_to_date()


def build_until_interrupted(folder: RunFolder, at: str) -> None:
    folder.prepare()
    for name in folder.resumable(list("abc")):
        if name == at:
            raise KeyboardInterrupt
        (folder.path / f"{name}.txt").write_text(name)
        folder.mark_done(name, {"length": 1})


def test_work_goes_on_after_an_interruption(folder: RunFolder) -> None:
    with folder.locked(), pytest.raises(KeyboardInterrupt):
        build_until_interrupted(folder, at="b")
    again = RunFolder(folder.path, IDENTITY)
    assert build(again) == ["b", "c"]
    assert again.result_of("a") == {"length": 1}
    assert again.result_of("b") == {}


def test_kept_items_are_dropped_when_the_configuration_changes_or_force_is_given(folder: RunFolder) -> None:
    build(folder)
    with folder.locked():
        assert RunFolder(folder.path, IDENTITY).prepare() == 3
        assert RunFolder(folder.path, IDENTITY).prepare(force=True) == 0
    build(folder)
    changed = RunFolder(folder.path, Identity("other", {}, 1))
    assert build(changed) == ["a", "b", "c"]


def test_items_need_different_keys_and_similar_ones_do_not_share_a_marker(folder: RunFolder) -> None:
    with folder.locked():
        with pytest.raises(ValueError, match="different keys"):
            folder.pending(["a", "a"])
        folder.prepare()
        folder.mark_done("type_1/bca", {"n": 1})
        assert RunFolder(folder.path, IDENTITY).result_of("type_1_bca") is None
        assert RunFolder(folder.path, IDENTITY).result_of("type_1/bca") == {"n": 1}


def test_two_processes_do_not_share_a_folder(folder: RunFolder) -> None:
    second = RunFolder(folder.path, IDENTITY)
    busy = pytest.raises(StageError, match=r"in use by process \d+ on .*: wait for it")
    with folder.locked(), busy, second.locked():
        pass
    with second.locked():
        assert not second.is_up_to_date()


def test_a_folder_with_somebodys_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StageError, match="files that no stage wrote"), RunFolder(tmp_path, IDENTITY).locked():
        pass
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


# ---- marks and kills


def work(path: Path, identity: Identity, names: str) -> RunFolder:
    """A stage: three items of a file each, one of them in a folder, another two by renaming; then a file of all."""
    folder = RunFolder(path, identity)
    with folder.locked():
        folder.prepare()
        for name in folder.resumable(list(names), key=lambda name: f"item {name}"):
            write_text(path / name / "log.txt", identity.config_hash + name)
            (path / name / "direct.txt").write_text(name)
        parts = [(path / name / "log.txt").read_text() for name in names]
        write_json(path / "results.json", parts)
        write_json(path / ".parts" / "a.json", "handed on within the stage")
        finish(folder)
    return folder


def outputs(path: Path) -> dict[str, bytes]:
    return {n: (path / n).read_bytes() for n in files_below(path) if n != "manifest.json"}


WRITES = {"open", "os.remove", "os.rmdir", "os.rename", "os.mkdir", "shutil.rmtree"}


def run_killed(path: Path, identity: Identity, names: str, at: int) -> bool:
    """Runs the stage in a forked process that is killed before its ``at``-th change of the file system.

    Returns:
        Whether it was killed, and not done before.
    """
    child = os.fork()
    if child == 0:
        count = 0

        def hear(event: str, arguments: tuple[object, ...]) -> None:
            nonlocal count
            if event in WRITES and not (event == "open" and not int(str(arguments[2])) & (os.O_WRONLY | os.O_RDWR)):
                count += 1
                if count == at:
                    os._exit(9)

        sys.addaudithook(hear)
        code = 1
        try:
            work(path, identity, names)
            code = 0
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9)
    return code == 9


def be_quick() -> None:
    """Waits for no disk, as a killed process loses nothing that the kernel has; knows commit and versions before."""
    os.fsync = lambda descriptor: None  # type: ignore[assignment]
    present_commit()
    software_versions()


@pytest.fixture(scope="module")
def small_process() -> Iterator[ProcessPoolExecutor]:
    """Forks of the tests' own process, which has gigabytes, take ten times as long."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=be_quick) as small:
        yield small


@pytest.fixture
def killed(
    small_process: ProcessPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Path, Identity, str, int], bool]:
    """`run_killed` in a small process."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    return lambda *given: small_process.submit(run_killed, *given).result()


def test_whatever_is_killed_wherever_the_next_run_ends_as_a_clean_one(
    tmp_path: Path, killed: Callable[[Path, Identity, str, int], bool]
) -> None:
    clean = outputs(work(tmp_path / "clean", IDENTITY, "abc").path)
    other = Identity("other", {}, 1)
    kills = 0
    for first, half_done in ((1, 25), (2, 10_000)):  # run A: killed in the middle, or done
        at, not_done = first, True
        while not_done:
            path = tmp_path / f"{half_done}-{at}"
            killed(path, IDENTITY, "abc", half_done)
            not_done = killed(path, other, "xyza", at)  # run B with other settings, at every third step
            work(path, IDENTITY, "abc")  # run A again
            assert outputs(path) == clean
            assert {entry.name for entry in path.iterdir()} == {*"abc", "results.json", "manifest.json", ".lock"}
            assert RunFolder(path, IDENTITY).is_up_to_date()
            shutil.rmtree(path)
            kills += not_done
            at += 3
    assert kills > 33


def test_an_unchanged_output_is_not_read_again(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    build(folder)
    finish(folder)
    monkeypatch.setattr(manifest, "hash_file", lambda file: read.append(file.name) or hash_file(file))
    assert folder.is_up_to_date()
    assert read == []
    before = (folder.path / "b.txt").stat()
    for content, same in (("b", True), ("B", False)):
        (folder.path / "b.txt").write_text(content)
        os.utime(folder.path / "b.txt", ns=(before.st_atime_ns, before.st_mtime_ns))
        assert folder.is_up_to_date() == same
    assert read == ["b.txt", "b.txt"]


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """A folder outside the run with files that must not change."""
    outside = tmp_path / "outside"
    outside.mkdir()
    for name in ("letter.txt", "identity.json", "b.txt"):
        (outside / name).write_text("mine")
    return outside


def unharmed(outside: Path) -> bool:
    names = sorted(path.relative_to(outside).as_posix() for path in outside.rglob("*") if path.is_file())
    wanted = ["b.txt", "identity.json", "letter.txt"]
    return names == wanted and all((outside / name).read_text() == "mine" for name in wanted)


def test_a_lock_that_is_no_file_is_refused_and_its_target_stays(folder: RunFolder, precious: Path) -> None:
    folder.path.mkdir(parents=True)
    lock = folder.path / ".lock"
    for make in (lambda: lock.symlink_to(precious / "letter.txt"), lambda: os.mkfifo(lock), lock.mkdir):
        make()
        with pytest.raises(StageError, match=r"\.lock is no file of this project: remove it"), folder.locked():
            pass
        lock.rmdir() if lock.is_dir() else lock.unlink()
    assert unharmed(precious)


@pytest.mark.parametrize("same", [True, False], ids=["goes on", "begins anew"])
@pytest.mark.parametrize("forged", [".progress", "sub", "b.txt", "temporary"])
def test_nothing_outside_a_run_folder_is_written_or_removed(folder, precious, forged: str, same: bool) -> None:
    build(folder, "ab")
    progress = folder.path / ".progress"
    if forged == ".progress":
        for path in progress.iterdir():
            shutil.copy(path, precious)
        shutil.rmtree(progress)
        progress.symlink_to(precious)
        for path in (*precious.glob("*-*"), precious / "commits.txt"):
            path.unlink()
        (precious / "identity.json").write_text("mine")
    elif forged == "temporary":
        (folder.path / f".writing-{os.getpid()}-c.txt").symlink_to(precious / "letter.txt")
    if forged == "sub":
        (folder.path / "sub").symlink_to(precious)
    if forged == "b.txt":
        (folder.path / "b.txt").unlink()
        (folder.path / "b.txt").symlink_to(precious / "b.txt")
    later = folder if same else RunFolder(folder.path, Identity("other", {}, 1))
    with later.locked():
        later.is_up_to_date()
        later.prepare()
        for name in later.resumable(list("abc")):
            write_text(later.path / f"{name}.txt", name)
    finish(later)
    assert unharmed(precious)
    assert later.is_up_to_date()
