"""Files that are written whole, and where results come from."""

import errno
import re
from pathlib import Path

import pytest

from pipeline.store.atomic_files import atomic_path, remove_unfinished, write_json, write_text
from pipeline.store.errors import is_no_room
from pipeline.store.provenance import hash_file, hash_value, machine, present_commit, software_versions


def write_half(target: Path) -> None:
    with atomic_path(target) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt


def test_a_failing_writer_leaves_the_old_file_and_no_litter(tmp_path: Path) -> None:
    target = tmp_path / "sub" / "a.json"
    write_text(target, "old")
    with pytest.raises(KeyboardInterrupt):
        write_half(target)
    assert target.read_text() == "old"
    assert list(target.parent.iterdir()) == [target]


def test_a_writer_replaces_the_file_and_keeps_its_suffix(tmp_path: Path) -> None:
    target = tmp_path / "grid.npz"
    with atomic_path(target) as temporary:
        assert temporary.suffix == ".npz"
        assert temporary.parent == tmp_path  # os.replace is atomic within one file system only
        temporary.write_bytes(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new"


def test_a_body_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a"):
        pass


def test_json_refuses_what_other_programs_cannot_read(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"force_n": float("nan")})
    assert not list(tmp_path.iterdir())


def test_leftovers_of_a_killed_writer_are_removed(tmp_path: Path) -> None:
    (tmp_path / "type_1").mkdir()
    (tmp_path / "type_1" / ".writing-123-lumen.stl").write_text("half")
    (tmp_path / "type_1" / "lumen.stl").write_text("whole")
    remove_unfinished(tmp_path)
    assert [p.name for p in (tmp_path / "type_1").iterdir()] == ["lumen.stl"]


def test_no_room_is_recognised_through_its_causes() -> None:
    def wrapped(number: int) -> RuntimeError:
        try:
            try:
                raise OSError(number, "message")
            except OSError as error:
                raise RuntimeError("saving failed") from error
        except RuntimeError as error:
            return error

    assert is_no_room(wrapped(errno.ENOSPC))
    assert is_no_room(OSError(errno.EDQUOT, "quota"))
    assert not is_no_room(wrapped(errno.EACCES))
    assert not is_no_room(None)


def test_hashes(tmp_path: Path) -> None:
    assert hash_value({"a": 1, "b": [2]}) == hash_value({"b": [2], "a": 1})
    assert hash_value({"a": 1}) != hash_value({"a": 2})
    (tmp_path / "a").write_bytes(b"abc")
    assert hash_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_versions_commit_and_machine_are_recorded() -> None:
    assert {"python", "numpy", "hydra-core"} <= set(software_versions())
    assert re.fullmatch(r"[0-9a-f]{12}\+?|unknown", present_commit())
    assert set(machine()) == {"operating_system", "processor", "cores", "memory_gb", "gpu"}
    assert int(machine()["cores"]) >= 1
