"""Export of a folder: the command, all or nothing, and what is refused."""

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.__main__ import main
from pipeline.episodes.export import exporting
from pipeline.episodes.export.exporting import export_logs
from pipeline.episodes.export.layout import ExportError, common_layout, layout_of


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


@pytest.mark.parametrize("kind", ["minari", "hdf5"])
def test_a_full_disk_is_told_before_an_episode_is_written(
    kind: str, wire_logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=2**20))
    with pytest.raises(ExportError, match="no room is left; nothing was left there"):
        export_logs(wire_logs, kind, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_destination_is_replaced_only_when_asked(wire_logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / ".writing-99999999-out" / "data").mkdir(parents=True)  # of a killed export
    assert main(["export", str(wire_logs), "--to", "hdf5", "--output", str(out), "--no-pictures"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    with pytest.raises(ExportError, match="is there already: give another folder, or --overwrite"):
        export_logs(wire_logs, "hdf5", out)
    (out / "mine.txt").write_text("mine")
    report = export_logs(wire_logs, "hdf5", out, pictures=False, overwrite=True)
    assert (report.episodes, report.steps) == (2, 15)
    assert [path.name for path in out.iterdir()] == ["episodes.hdf5"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_logs_are_not_replaced_by_their_export(wire_logs: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(wire_logs, run / "expert")
    for destination in (run / "expert", run):
        with pytest.raises(ExportError, match="holds the logs, which it would replace: give another folder"):
            export_logs(run / "expert", "hdf5", destination, pictures=False, overwrite=True)
    assert len(list(run.rglob("*.mcap"))) == len(list(wire_logs.rglob("*.mcap")))
    with pytest.raises(ExportError, match="masks are pictures"):
        export_logs(wire_logs, "hdf5", tmp_path / "out", pictures=False, masks=True)


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


def test_fields_of_a_wire(wire_logs: Path) -> None:
    with EpisodeReader(wire_logs / "0.mcap") as log:
        layout = layout_of(log, masks=True)
    assert layout.fps == 10
    assert type(layout.fps) is int
    assert layout.action.parts == ("translation", "rotation")
    assert layout.observations["tip"].frame == "world"
    assert layout.observations["tip"].parts == ("tip_x_m", "tip_y_m", "tip_z_m")
    assert {"tip", "feeder", "force", "goal", "joint_positions", "joint_velocities"} == set(layout.observations)
    assert {name: one.shape for name, one in layout.pictures.items()} == {"frontal": (48, 48), "frontal_mask": (48, 48)}
    assert "distance_m" in layout.infos
    assert layout.describe()["observations"]["force"]["unit"] == "N"


def test_fields_of_two_devices(dual_logs: Path) -> None:
    layout = common_layout(sorted(dual_logs.glob("*.mcap")), pictures=False)
    assert layout.action.parts == ("wire_translation", "wire_rotation", "catheter_translation", "catheter_rotation")
    of_catheter = tuple(f"catheter_{part}" for part in ("insertion_m", "rotation_cos", "rotation_sin"))
    assert layout.observations["feeder"].parts[3:] == (*of_catheter, "lead_m")
    assert layout.infos["device_feeder_forces"].shape == (2,)
    assert not layout.pictures


def test_logs_that_differ_are_refused_by_name(
    wire_logs: Path, dual_logs: Path, record_logs: Callable[..., Path], tmp_path: Path
) -> None:
    shutil.copy(wire_logs / "0.mcap", tmp_path / "a.mcap")
    shutil.copy(dual_logs / "0.mcap", tmp_path / "b.mcap")
    with pytest.raises(ExportError, match=r"a.mcap and .*b.mcap differ in action \(2 and 4\)") as caught:
        common_layout([tmp_path / "a.mcap", tmp_path / "b.mcap"])
    assert "\n" not in str(caught.value)
    assert "device_lead (none and one number)" in str(caught.value)
    other = record_logs(tmp_path / "other", image_size=32)
    with pytest.raises(ExportError, match=r"differ in pictures of frontal \(48x48 and 32x32\)"):
        common_layout([tmp_path / "a.mcap", other / "0.mcap"])
    common_layout([tmp_path / "a.mcap", other / "0.mcap"], pictures=False)
