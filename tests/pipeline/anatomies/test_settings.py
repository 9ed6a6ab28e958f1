"""Anatomies: settings that choose them, and files of one's own."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import load_phantom
from pipeline.anatomies.anatomy_file import AnatomyFile, world_point
from pipeline.anatomies.settings import (
    GENERATED_TARGETS,
    require_known_entry,
    require_known_phantoms,
    require_known_targets,
)
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages.expert import ExpertSettings
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.store.errors import ConfigurationError

USUAL: dict[str, Any] = {"phantoms": ["type_1", "type_2"], "targets": ["bca", "lcca"]}


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    path = tmp_path / "patient.stl"
    path.write_bytes(b"solid")
    return path


def test_a_choice_leaves_one_of_each_and_counts_as_the_same_list(mesh: Path) -> None:
    chosen = ExpertSettings(**USUAL, phantom="bovine", target="lsa")
    assert chosen == ExpertSettings(phantoms=["bovine"], targets=["lsa"])
    assert ExpertSettings(**USUAL, phantom="random", phantom_seed=7).phantoms == ["random_7"]
    assert ExpertSettings(**USUAL, phantom_seed=7).phantoms == ["random_7"]
    assert ExpertSettings(**USUAL, point_mm=[27.0, -2.0, 70.0]).targets == ["point_27.0_-2.0_70.0_mm"]
    assert ExpertSettings(**USUAL, file=str(mesh)).phantoms == ["patient"]
    assert ExpertSettings(**USUAL, entry="lsa_end").task.entry == "lsa_end"
    assert ExpertSettings(**USUAL, entry=[10, 20, 30]).task.entry == "0.01, 0.02, 0.03"
    assert EnnSettings(**USUAL, ablation_phantoms=["type_1"], file=str(mesh)).ablation_phantoms == ["patient"]


def test_results_depend_on_the_file_s_content_and_name_and_not_on_where_it_lies(mesh: Path, tmp_path: Path) -> None:
    def identity(path: Path) -> dict[str, Any]:
        return settings_that_matter(ExpertSettings(**USUAL, file=str(path)))

    (tmp_path / "other").mkdir()
    copy = Path(shutil.copy(mesh, tmp_path / "other" / "patient.stl"))
    assert identity(copy) == identity(mesh)
    copy.write_bytes(b"another")
    assert identity(copy)["file_sha256"] != identity(mesh)["file_sha256"]
    renamed = Path(shutil.copy(mesh, tmp_path / "somebody.stl"))
    assert identity(renamed)["file_name"] == "somebody"


def test_unseen_learns_in_random_arches_and_tests_what_is_asked_for(mesh: Path) -> None:
    assert UnseenSettings(target="lsa").targets == ["lsa"]
    assert UnseenSettings(target="rcca").targets == ["rcca"]
    other = UnseenSettings(target="lcca_end", file=str(mesh), phantoms=["type_1"], entry="lsa_end")
    assert (other.targets, other.own_targets, other.phantoms) == (["bca", "lcca", "lsa"], ["lcca_end"], ["patient"])
    assert (other.own_entry, other.task.entry) == ("lsa_end", "descending")


def test_navigation_keeps_what_is_learnt_in_out_of_the_transfer(mesh: Path) -> None:
    values: dict[str, Any] = {**USUAL, "phantoms": ["type_1"], "transfer_phantoms": ["type_2"], "episodes": [1]}
    assert NavigationSettings(**values, phantom="type_2").transfer_phantoms == []
    assert NavigationSettings(**values, file=str(mesh)).transfer_phantoms == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"file": "missing.stl"}, "phantom.file=missing.stl is no file: give the path of a surface"),
        ({"labels": {3: "aorta"}}, "phantom.labels belongs to a file: give phantom.file=PATH too"),
        ({"names": ["bca"]}, "phantom.names belongs to a file"),
        ({"file": __file__, "transform": "affine"}, "stage.transform"),
        ({"file": __file__, "phantom": "type_1"}, "phantom.file brings the anatomy: leave out phantom.name"),
        ({"target": "bca", "point_mm": [0.0, 0.0, 0.0]}, "stage.point_mm is the target: leave out target"),
        ({"point_mm": [0.0, 1.0]}, "stage.point_mm"),
        ({"labels": {1.5: "aorta"}}, "stage.labels must be a mapping"),
        ({"labels": "aorta"}, "stage.labels must be a mapping"),
        ({"labels": {3: "../x"}}, "stage.labels cannot be '../x'"),
        ({"entry": [1.0, float("nan"), 2.0]}, "stage.entry must be a name"),
        ({"entry": "a b"}, "stage.entry cannot be 'a b'"),
        ({"phantoms": []}, "stage.phantoms is empty: name at least one"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{re.escape(message)}"):
        ExpertSettings(**USUAL | values)


def test_names_are_folders_and_none_of_the_library() -> None:
    names = {
        "/data/my patient.stl": "my_patient",
        "Segmentation.seg.nrrd": "Segmentation",
        "/data/s0011/segmentations/": "segmentations",
        "low_tortuosity.stl": "low_tortuosity_file",  # a name of the library, which it must not be taken for
        "random_7.glb": "random_7_file",
        "unseen.stl": "unseen_file",  # the stage unseen calls its random arches so
        ".stl": "anatomy",
        "Ünïcode.ply": "n_code",
        "a" * 200 + ".stl": "a" * 60,
    }
    assert {path: AnatomyFile(path).name for path in names} == names


def test_labels_of_a_file_are_numbers_and_those_of_a_folder_names(tmp_path: Path) -> None:
    labels = {"3": "aorta", "lsa_label": None}
    file = AnatomyFile.of("scan.nii.gz", None, {"lcca": "lsa"}, labels)
    assert file.labels == ((3, "aorta"), ("lsa_label", None))
    assert file.names == (("lcca", "lsa"),)
    folder = AnatomyFile.of(str(tmp_path), None, ["bca", "lcca"], labels)
    assert folder.labels == (("3", "aorta"), ("lsa_label", None))
    assert folder.names == ("bca", "lcca")
    assert AnatomyFile.of("a.stl", "mm", None, None) == AnatomyFile("a.stl", "mm")


def test_points_without_a_file_are_in_the_world_frame() -> None:
    assert world_point(load_phantom("type_1"), [27.0, -2.0, 70.0]) == pytest.approx((0.027, -0.002, 0.07))
    assert np.isfinite(world_point(load_phantom("type_1"), [0, 0, 0])).all()


def test_unknown_names_say_what_there_is() -> None:
    with pytest.raises(ConfigurationError, match="phantom 'random' needs a seed: write random_7, or "):
        require_known_phantoms(["random"])
    with pytest.raises(ConfigurationError, match="unknown entry 'groin' in phantom 'type_1'; choose from descending"):
        require_known_entry("groin", ["type_1"])
    require_known_entry("lsa_end", ["type_1", "bovine"])


def test_every_generated_arch_has_the_targets_that_stages_learn() -> None:
    require_known_targets(GENERATED_TARGETS)
    for arch in ("bovine", "random_7", "random_wide_5", "random_scan_11"):
        assert set(load_phantom(arch).targets) >= set(GENERATED_TARGETS)
    with pytest.raises(ConfigurationError, match="unknown target 'lcca_end'"):
        require_known_targets(["lcca_end"])
    require_known_targets(["rsa"], ["type_1", "bovine"])
    with pytest.raises(ConfigurationError, match="unknown target 'rcca_start' in phantom 'type_1'"):
        require_known_targets(["rcca_start"], ["type_1"])
