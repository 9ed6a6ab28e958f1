"""The phantoms stage on a mesh: built, up to date until the file changes, refused in one sentence."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import load_phantom
from pipeline.anatomies.anatomy_file import in_settings
from pipeline.launch import main
from pipeline.stages.phantoms import PhantomsSettings
from pipeline.store.errors import ConfigurationError


@pytest.fixture
def arch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    lumen = load_phantom("type_1", resolution=2e-3).lumen_mesh
    twice = np.concatenate((lumen.faces, lumen.faces[:3]))  # which the import notes
    mesh = trimesh.Trimesh(1e3 * lumen.vertices, twice, process=False)
    mesh.export(tmp_path / "my arch.stl")
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "my arch.stl"


def test_a_mesh_is_built_once(arch: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    arguments = [
        "stage=phantoms",
        f"phantom.mesh='{arch}'",
        "phantom.names={rsa: right_arm}",
        "stage.resolution_mm=2.0",
        f"runs_dir={tmp_path / 'runs'}",
    ]
    assert main(arguments) == 0
    folder = tmp_path / "runs" / "desk" / "phantoms" / "my_arch"
    account = json.loads((folder / "import.json").read_text())
    assert account["unit"] == "mm"
    assert account["notes"] == ["3 degenerate or repeated faces dropped"]
    told = capfd.readouterr()
    assert "my_arch: unit mm (" in told.out
    assert told.out.startswith(f"phantoms: reading {arch}, ")
    assert "right_arm" in next(line for line in told.out.splitlines() if "; targets " in line)
    assert (told.out + told.err).count("3 degenerate or repeated faces dropped") == 1
    ending = told.out.splitlines()[-len(account["notes"]) - 2 :]
    assert ending[:-2] == [f"my_arch: note: {note}" for note in account["notes"]]
    assert ending[-2] == f"my_arch: picture: {folder / 'picture.png'}"
    assert "right_arm" in json.loads((folder / "targets.json").read_text())["targets"]
    assert trimesh.load(folder / "lumen.stl").is_watertight
    manifest = folder.parent / "manifest.json"
    written = manifest.stat().st_mtime_ns
    assert main(arguments) == 0
    assert manifest.stat().st_mtime_ns == written
    (tmp_path / "text.stl").write_text("no mesh at all")
    assert main(["stage=phantoms", f"phantom.mesh={tmp_path / 'text.stl'}", arguments[-1]]) == 2
    assert manifest.stat().st_mtime_ns == written, "earlier results stay where they are"


def test_a_folder_counts_by_its_files(tmp_path: Path):
    folder = tmp_path / "patient"
    folder.mkdir()
    (folder / "aorta.nii.gz").write_bytes(b"one")
    digest = PhantomsSettings(file=str(folder)).file_sha256
    (folder / "aorta.nii.gz").write_bytes(b"two")
    assert digest is not None
    assert digest != PhantomsSettings(file=str(folder)).file_sha256


def test_the_files_content_counts(tmp_path: Path):
    first, second = tmp_path / "a.stl", tmp_path / "b.stl"
    first.write_bytes(b"one")
    second.write_bytes(b"two")
    digest = PhantomsSettings(file=str(first)).file_sha256
    assert digest is not None
    assert digest != PhantomsSettings(file=str(second)).file_sha256
    second.write_bytes(b"one")
    assert digest == PhantomsSettings(file=str(second)).file_sha256


def test_what_a_scene_refers_to_counts(tmp_path: Path):
    import trimesh

    path = tmp_path / "model.gltf"
    trimesh.Scene(trimesh.creation.icosphere(1, 20.0)).export(path)
    digest = PhantomsSettings(file=str(path)).file_sha256
    for data in tmp_path.glob("*.bin"):
        data.write_bytes(bytes(len(data.read_bytes())))
    assert digest != PhantomsSettings(file=str(path)).file_sha256


def test_wrong_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(ConfigurationError, match=r"phantom.file=none.stl is no file"):
        PhantomsSettings(file="none.stl")
    os.mkfifo(tmp_path / "pipe.stl")
    with pytest.raises(ConfigurationError, match=r"phantom.file=.*pipe.stl is no file"):
        PhantomsSettings(file=str(tmp_path / "pipe.stl"))
    with pytest.raises(ConfigurationError, match=r"phantom.unit belongs to a file"):
        PhantomsSettings(phantoms=["type_1"], unit="mm")
    text = tmp_path / "text.stl"
    text.write_text("no mesh at all\n" * 20)
    assert main(["stage=phantoms", f"phantom.mesh={text}", f"runs_dir={tmp_path / 'runs'}"]) == 2
    assert "text.stl cannot be read as a mesh: it begins as no STL file" in capsys.readouterr().err
    assert main(["stage=phantoms", f"phantom.mesh={text}", "phantom.unit=foot", f"runs_dir={tmp_path / 'runs'}"]) == 2
    assert "unknown unit 'foot'; choose from m, cm, mm, inch" in capsys.readouterr().err
    assert not list((tmp_path / "runs").rglob("*")), "nothing is left of what was refused"


def test_what_an_import_advises_is_named_as_settings():
    text = "a.nii.gz: say which is which by labels={number: 'aorta'}; transform='qform' takes the other"
    assert in_settings(text) == (
        "a.nii.gz: say which is which by phantom.labels={number: 'aorta'}; phantom.transform='qform' takes the other"
    )
    assert in_settings(in_settings(text)) == in_settings(text)
