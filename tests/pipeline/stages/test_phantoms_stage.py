"""The phantoms stage: its files say what the anatomy says, also that of a mesh; a second run has nothing to do."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import load_phantom
from pipeline.anatomies.anatomy_file import in_settings
from pipeline.launch import main
from pipeline.stages.phantoms import PhantomsSettings, check_phantoms, write_bundle
from pipeline.store.errors import ConfigurationError
from pipeline.store.manifest import read_manifest

RESOLUTION = 2e-3


@pytest.fixture(scope="module")
def phantom():
    return load_phantom("type_1", resolution=RESOLUTION)


@pytest.fixture(scope="module")
def bundle(phantom, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundle") / "type_1"
    write_bundle(phantom, folder, wall_thickness=1.5e-3, picture=False)
    return folder


def test_files_say_what_the_anatomy_says_and_the_wall_lies_around_the_lumen(bundle, phantom) -> None:
    lumen, wall = trimesh.load(bundle / "lumen.stl"), trimesh.load(bundle / "wall.stl")
    assert lumen.is_watertight
    assert lumen.volume == pytest.approx(phantom.lumen_mesh.volume, rel=1e-4)
    # A wall of 1.5 mm: no part of it reaches into the lumen, and its outside lies that far out.
    depth = phantom.grid.sample(np.asarray(wall.vertices))
    assert depth.max() < 0.5 * RESOLUTION
    assert depth.min() == pytest.approx(-1.5e-3, abs=0.5 * RESOLUTION)
    with np.load(bundle / "grid.npz") as grid:
        np.testing.assert_array_equal(grid["values"], phantom.grid.values)
        np.testing.assert_array_equal(grid["origin"], phantom.grid.origin)
        assert np.allclose(grid["spacing"], RESOLUTION)
    centrelines = json.loads((bundle / "centrelines.json").read_text())
    assert {"aorta", "bca", "lcca", "lsa"} <= set(centrelines)
    for branch in phantom.tree.branches:
        np.testing.assert_allclose(centrelines[branch.name]["points_m"], branch.points)
        assert len(centrelines[branch.name]["radius_m"]) == len(branch.points)
    places = json.loads((bundle / "targets.json").read_text())
    assert {"bca", "lcca", "lsa"} <= set(places["targets"])
    np.testing.assert_allclose(places["targets"]["bca"]["position_m"], phantom.targets["bca"].position)
    assert np.linalg.norm(places["entries"]["descending"]["direction"]) == pytest.approx(1)
    assert json.loads((bundle / "phantom.json").read_text())["hash"] == phantom.hash


@pytest.mark.parametrize(
    ("phantoms", "message"),
    [([], "stage.phantoms is empty"), (["type_1"] * 2, "something twice"), (["type_1", "type_9"], "phantom 'type_9'")],
)
def test_phantoms_are_known_ones_and_each_once(phantoms: list[str], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        check_phantoms(PhantomsSettings(phantoms=phantoms))


def test_stage_ends_at_once_when_up_to_date_and_runs_again_when_told_or_changed(pipeline_process) -> None:
    settings = ("stage.phantoms=[type_1]", "stage.resolution_mm=2.5", "stage.picture=false")
    command = ("stage=phantoms", *settings, "name=run")
    manifest = pipeline_process.runs / "run" / "phantoms" / "manifest.json"
    first = pipeline_process.run_here(*command)
    assert "phantoms: done in" in first.stdout, first.stderr
    written, kept = manifest.read_bytes(), read_manifest(manifest.parent)

    second = pipeline_process.run_here(*command)
    assert "phantoms: up to date in" in second.stdout
    assert manifest.read_bytes() == written
    forced = pipeline_process.run_here(*command, "force=true")
    assert "phantoms: done in" in forced.stdout
    made = read_manifest(manifest.parent)
    assert (made and made.outputs_hash) == (kept and kept.outputs_hash)  # same settings, same bits
    seeded = pipeline_process.run_here(*command, "seed=1")
    assert "phantoms: up to date in" in seeded.stdout  # named phantoms are the same for every seed
    changed = pipeline_process.run_here(*command, "stage.wall_thickness_mm=1.6")
    assert "phantoms: done in" in changed.stdout


def test_random_phantoms_and_pictures_are_written_and_offered_to_the_report(pipeline_process) -> None:
    done = pipeline_process.run_here("stage=phantoms", "stage.phantoms=[random_5]", "stage.resolution_mm=2.5")
    assert done.returncode == 0, done.stderr
    folder = pipeline_process.runs / "desk" / "phantoms"
    assert (folder / "random_5" / "lumen.stl").is_file()
    assert (folder / "random_5" / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert set(json.loads((folder / "results.json").read_text())["phantoms"]) == {"random_5"}
    (figure,) = json.loads((folder / "figures.json").read_text())
    assert figure["file"] == "random_5/picture.png"


def test_a_resolution_the_anatomy_cannot_be_built_at_is_one_sentence(pipeline_process) -> None:
    done = pipeline_process.run_here("stage=phantoms", "stage.phantoms=[type_1]", "stage.resolution_mm=0.1")
    assert done.returncode == 2
    (sentence,) = done.stderr.strip().splitlines()
    assert "type_1" in sentence


@pytest.fixture
def arch(phantom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    lumen = phantom.lumen_mesh
    twice = np.concatenate((lumen.faces, lumen.faces[:3]))  # which the import notes
    mesh = trimesh.Trimesh(1e3 * lumen.vertices, twice, process=False)
    mesh.export(tmp_path / "my arch.stl")
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "my arch.stl"


def test_a_mesh_is_built_once(arch: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    arguments = [
        "stage=phantoms",
        f"phantom.file='{arch}'",
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
    assert (told.out + told.err).count("3 degenerate or repeated faces dropped") == 1
    assert str(folder / "picture.png") in told.out
    assert "right_arm" in json.loads((folder / "targets.json").read_text())["targets"]
    assert trimesh.load(folder / "lumen.stl").is_watertight
    manifest = folder.parent / "manifest.json"
    written = manifest.stat().st_mtime_ns
    assert main(arguments) == 0
    assert manifest.stat().st_mtime_ns == written
    (tmp_path / "text.stl").write_text("no mesh at all")
    assert main(["stage=phantoms", f"phantom.file={tmp_path / 'text.stl'}", arguments[-1]]) == 2
    assert manifest.stat().st_mtime_ns == written, "earlier results stay where they are"


def test_files_of_a_folder_and_what_a_scene_refers_to_count(tmp_path: Path):
    folder, scene = tmp_path / "patient", tmp_path / "model.gltf"
    folder.mkdir()
    (folder / "aorta.nii.gz").write_bytes(b"one")
    trimesh.Scene(trimesh.creation.icosphere(1, 20.0)).export(scene)
    before = [PhantomsSettings(file=str(path)).file_sha256 for path in (folder, scene)]
    (folder / "aorta.nii.gz").write_bytes(b"two")
    for data in tmp_path.glob("*.bin"):
        data.write_bytes(bytes(len(data.read_bytes())))
    for digest, path in zip(before, (folder, scene), strict=True):
        assert digest is not None
        assert digest != PhantomsSettings(file=str(path)).file_sha256


def test_what_is_no_mesh_is_refused_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    os.mkfifo(tmp_path / "pipe.stl")
    with pytest.raises(ConfigurationError, match=r"phantom.file=.*pipe.stl is no file"):
        PhantomsSettings(file=str(tmp_path / "pipe.stl"))
    text = tmp_path / "text.stl"
    text.write_text("no mesh at all\n" * 20)
    arguments = ["stage=phantoms", f"phantom.file={text}", f"runs_dir={tmp_path / 'runs'}"]
    for further, message in (([], "text.stl cannot be read as a mesh"), (["phantom.unit=foot"], "unknown unit 'foot'")):
        assert main([*arguments, *further]) == 2
        assert message in capsys.readouterr().err
    assert not list((tmp_path / "runs").rglob("*"))


def test_what_an_import_advises_is_named_as_settings():
    text = "a.nii.gz: say which is which by labels={number: 'aorta'}; transform='qform' takes the other"
    told = text.replace("labels", "phantom.labels").replace("transform", "phantom.transform")
    assert in_settings(text) == in_settings(told) == told
