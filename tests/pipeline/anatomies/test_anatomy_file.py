"""Anatomies of files: their names, what is said of them on the command line, and points in the file's axes."""

from __future__ import annotations

from pathlib import Path

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
from pipeline.store.errors import ConfigurationError


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("/data/my patient.stl", "my_patient"),
        ("scan_labels.nii.gz", "scan_labels"),
        ("Segmentation.seg.nrrd", "Segmentation"),
        ("/data/s0011/segmentations/", "segmentations"),
        ("low_tortuosity.stl", "low_tortuosity_file"),  # a name of the library, which it must not be taken for
        ("random_7.glb", "random_7_file"),
        (".stl", "anatomy"),
        ("Ünïcode.ply", "n_code"),
        ("a" * 200 + ".stl", "a" * 60),
    ],
)
def test_names_are_folders_and_none_of_the_library(path: str, name: str) -> None:
    assert AnatomyFile(path).name == name


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
    with pytest.raises(ConfigurationError, match="unknown target 'lcca_end': choose from bca, lcca, lsa, rsa, rcca"):
        require_known_targets(["lcca_end"])
    require_known_targets(["rsa"], ["type_1", "bovine"])
    with pytest.raises(ConfigurationError, match="unknown target 'rcca_start' in phantom 'type_1'"):
        require_known_targets(["rcca_start"], ["type_1"])
