"""Export of a folder: the command, all or nothing, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pipeline.episodes.__main__ import main
from pipeline.episodes.export import exporting
from pipeline.episodes.export.exporting import export_logs
from pipeline.episodes.export.layout import ExportError


@pytest.mark.parametrize("kind", ["lerobot", "minari", "hdf5"])
def test_an_interrupted_export_leaves_nothing(
    kind: str, wire_logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    writer, added = exporting.WRITERS[kind], []

    class Stopped(writer):  # type: ignore[misc,valid-type]
        def add(self, episode: object) -> None:
            super().add(episode)
            added.append(episode)
            if len(added) == 2:
                raise KeyboardInterrupt

    monkeypatch.setitem(exporting.WRITERS, kind, Stopped)
    destination = tmp_path / "out"
    assert main(["export", str(wire_logs), "--to", kind, "--output", str(destination)]) == 130
    assert "interrupted: nothing was left" in capsys.readouterr().err
    assert len(added) == 2
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_export_left_is_removed(wire_logs: Path, tmp_path: Path) -> None:
    left = tmp_path / ".writing-99999999-out"
    (left / "data").mkdir(parents=True)
    export_logs(wire_logs, "hdf5", tmp_path / "out", pictures=False)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_destination_is_replaced_only_when_asked(wire_logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["export", str(wire_logs), "--to", "hdf5", "--output", str(out), "--no-pictures"]) == 0
    with pytest.raises(ExportError, match="is there already: give another folder, or --overwrite"):
        export_logs(wire_logs, "hdf5", out)
    (out / "mine.txt").write_text("mine")
    report = export_logs(wire_logs, "hdf5", out, pictures=False, overwrite=True)
    assert (report.episodes, report.steps) == (2, 15)
    assert [path.name for path in out.iterdir()] == ["episodes.hdf5"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_wrong_folders_and_names_are_refused(
    wire_logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, message in (
        ([str(tmp_path / "none")], "is no folder: give one with episode logs"),
        ([str(tmp_path)], "holds no episode log"),
        ([str(wire_logs), "--name", "my data"], "a data set cannot be called 'my data'"),
    ):
        assert main(["export", *arguments, "--to", "hdf5", "--output", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_a_damaged_log_is_named(wire_logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(wire_logs, tmp_path / "logs")
    log = tmp_path / "logs" / "1.mcap"
    log.write_bytes(log.read_bytes()[:-100])
    assert main(["export", str(tmp_path / "logs"), "--to", "lerobot", "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert "1.mcap is damaged" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
