"""Provenance: hashes follow content, versions and commit are recorded."""

from __future__ import annotations

import re
from pathlib import Path

from pipeline.settings.kinds import settings_that_matter
from pipeline.stages.expert import ExpertSettings
from pipeline.store.provenance import hash_file, hash_value, machine, present_commit, software_versions


def test_hash_of_a_value_ignores_the_order_of_keys() -> None:
    assert hash_value({"a": 1, "b": [2]}) == hash_value({"b": [2], "a": 1})
    assert hash_value({"a": 1}) != hash_value({"a": 2})


def test_hash_of_a_file_is_sha256(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert hash_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_versions_commit_and_machine_are_recorded() -> None:
    assert {"python", "numpy", "hydra-core"} <= set(software_versions())
    assert re.fullmatch(r"[0-9a-f]{12}\+?|unknown", present_commit())
    assert set(machine()) == {"operating_system", "processor", "cores", "memory_gb", "gpu"}
    assert int(machine()["cores"]) >= 1


def test_settings_that_cannot_change_results_stay_out_of_the_hash() -> None:
    settings = ExpertSettings(phantoms=["type_1"], targets=["bca"], threads=2)
    assert "threads" not in settings_that_matter(settings)
    assert settings_that_matter(settings)["targets"] == ["bca"]
