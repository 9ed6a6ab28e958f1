"""The phantoms stage: its files say what the anatomy says, and a second run has nothing to do."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from pipeline.stages.phantoms import PhantomsSettings, check_phantoms, write_bundle
from pipeline.store.errors import ConfigurationError

RESOLUTION = 2e-3


@pytest.fixture(scope="module")
def phantom():
    from cathsim.anatomy import load_phantom

    return load_phantom("type_1", resolution=RESOLUTION)


@pytest.fixture(scope="module")
def bundle(phantom, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundle") / "type_1"
    write_bundle(phantom, folder, wall_thickness=1.5e-3, picture=False)
    return folder


def test_meshes_are_closed_and_the_wall_lies_around_the_lumen(bundle, phantom) -> None:
    lumen, wall = trimesh.load(bundle / "lumen.stl"), trimesh.load(bundle / "wall.stl")
    assert lumen.is_watertight
    assert lumen.volume == pytest.approx(phantom.lumen_mesh.volume, rel=1e-4)
    # A wall of 1.5 mm: no part of it reaches into the lumen, and its outside lies that far out.
    depth = phantom.grid.sample(np.asarray(wall.vertices))
    assert depth.max() < 0.5 * RESOLUTION
    assert depth.min() == pytest.approx(-1.5e-3, abs=0.5 * RESOLUTION)


def test_grid_and_centrelines_and_targets_round_trip(bundle, phantom) -> None:
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


def test_unknown_phantoms_are_refused_with_the_valid_ones() -> None:
    with pytest.raises(
        ConfigurationError, match=r"unknown phantom 'type_9': choose from type_1, .*bovine.*random_seeds"
    ):
        check_phantoms(PhantomsSettings(phantoms=["type_1", "type_9"]))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"phantoms": []}, "stage.phantoms is empty"),
        ({"phantoms": ["type_1", "type_1"]}, "names something twice"),
        ({"phantoms": ["type_1"], "resolution_mm": 5.0}, r"stage\.resolution_mm must be 2\.5 or less, got 5"),
        ({"phantoms": ["type_1"], "wall_thickness_mm": 0.0}, "stage.wall_thickness_mm must be 0.1 or more"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        PhantomsSettings(**settings)


def test_stage_ends_at_once_when_up_to_date_and_runs_again_when_told_or_changed(pipeline_process) -> None:
    command = (
        "stage=phantoms",
        "stage.phantoms=[type_1]",
        "stage.resolution_mm=2.5",
        "stage.picture=false",
        "name=run",
    )
    manifest = pipeline_process.runs / "run" / "phantoms" / "manifest.json"
    first = pipeline_process.run_here(*command)
    assert "phantoms: done in" in first.stdout, first.stderr
    written = manifest.read_bytes()

    second = pipeline_process.run_here(*command)
    assert "phantoms: up to date in" in second.stdout
    assert manifest.read_bytes() == written
    forced = pipeline_process.run_here(*command, "force=true")
    assert "phantoms: done in" in forced.stdout
    assert json.loads(manifest.read_bytes())["outputs"] == json.loads(written)["outputs"]  # same settings, same bits
    seeded = pipeline_process.run_here(*command, "seed=1")
    assert "phantoms: up to date in" in seeded.stdout  # named phantoms are the same for every seed
    changed = pipeline_process.run_here(*command, "stage.wall_thickness_mm=1.6")
    assert "phantoms: done in" in changed.stdout


def test_random_phantoms_and_pictures_are_written_and_offered_to_the_report(pipeline_process) -> None:
    done = pipeline_process.run_here(
        "stage=phantoms", "stage.phantoms=[]", "stage.random_seeds=[5]", "stage.resolution_mm=2.5"
    )
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
    assert sentence.startswith("phantom type_1 cannot be built: resolution must lie in")
