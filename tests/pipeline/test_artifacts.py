"""Run folders: up-to-date check, resuming, locking and what is removed when things change."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from pipeline.artifacts import Identity, Manifest, RunFolder, read_manifest
from pipeline.errors import FolderBusyError, StageError

IDENTITY = Identity("config", {"phantoms": "inputs"}, "code")


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
    assert set(written.outputs) == {"a.txt", "b.txt", "c.txt"}
    assert written.outputs["a.txt"]["bytes"] == 1
    assert 2.0 <= written.wall_time_s < 10
    assert not (folder.path / ".progress").exists()


@pytest.mark.parametrize("changed", [
    Identity("other", {"phantoms": "inputs"}, "code"),
    Identity("config", {"phantoms": "other"}, "code"),
    Identity("config", {"phantoms": "inputs"}, "other"),
], ids=["config", "inputs", "code"])  # fmt: skip
def test_a_change_puts_the_folder_out_of_date_and_clears_it(folder: RunFolder, changed: Identity) -> None:
    build(folder)
    finish(folder)
    later = RunFolder(folder.path, changed)
    assert not later.is_up_to_date()
    assert build(later, "x") == ["x"]
    assert set(finish(later).outputs) == {"x.txt"}


def test_a_missing_or_cut_output_puts_the_folder_out_of_date(folder: RunFolder) -> None:
    build(folder)
    finish(folder)
    (folder.path / "b.txt").write_text("")
    assert not folder.is_up_to_date()
    (folder.path / "b.txt").unlink()
    assert not folder.is_up_to_date()


@pytest.mark.parametrize("content", ["", "{", "[]", '{"version": 99}', '{"version": 1, "stage": "x"}'])
def test_an_unreadable_manifest_counts_as_not_run(folder: RunFolder, content: str) -> None:
    build(folder)
    finish(folder)
    (folder.path / "manifest.json").write_text(content)
    assert read_manifest(folder.path) is None
    assert not folder.is_up_to_date()


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
    changed = RunFolder(folder.path, Identity("other", {}, "code"))
    assert build(changed) == ["a", "b", "c"]


def test_items_need_different_keys(folder: RunFolder) -> None:
    with folder.locked(), pytest.raises(ValueError, match="different keys"):
        folder.pending(["a", "a"])


def test_similar_keys_do_not_share_a_marker(folder: RunFolder) -> None:
    with folder.locked():
        folder.prepare()
        folder.mark_done("type_1/bca", {"n": 1})
        assert RunFolder(folder.path, IDENTITY).result_of("type_1_bca") is None
        assert RunFolder(folder.path, IDENTITY).result_of("type_1/bca") == {"n": 1}


def test_two_processes_do_not_share_a_folder(folder: RunFolder) -> None:
    second = RunFolder(folder.path, IDENTITY)
    busy = pytest.raises(FolderBusyError, match=r"in use by process \d+ on .*: wait for it")
    with folder.locked(), busy, second.locked():
        pass
    with second.locked():
        assert not second.is_up_to_date()


def test_a_folder_with_somebodys_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StageError, match="files that no stage wrote"), RunFolder(tmp_path, IDENTITY).locked():
        pass
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_manifest_is_plain_json(folder: RunFolder) -> None:
    build(folder)
    finish(folder)
    content = json.loads((folder.path / "manifest.json").read_text())
    assert content["identity"]["input_hashes"] == {"phantoms": "inputs"}
    assert {"git", "versions", "wall_time_s", "seed", "budget", "finished"} <= set(content)
