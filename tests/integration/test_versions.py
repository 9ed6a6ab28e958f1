"""The five distributions name one version, and the ranges of what they need hold what is pinned."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT_ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (".", *(f"packages/{name}" for name in ("cathsim", "enn", "guide3d", "splineformer")))


def project(folder: str) -> dict[str, Any]:
    return tomllib.loads((PROJECT_ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def pinned() -> dict[str, str]:
    lines = (PROJECT_ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {canonicalize_name(name): version.split(";")[0].strip() for name, version in pairs}


def requirements(folder: str) -> list[Requirement]:
    described = project(folder)
    extras = described.get("optional-dependencies", {}).values()
    return [Requirement(text) for text in (*described["dependencies"], *(text for extra in extras for text in extra))]


def test_all_have_one_version() -> None:
    versions = {folder: project(folder)["version"] for folder in FOLDERS}
    assert len(set(versions.values())) == 1, versions
    siblings = {one.name: one for one in requirements(".") if one.name.startswith("endonav-")}
    assert set(siblings) == {project(folder)["name"] for folder in FOLDERS[1:]}
    assert all(one.specifier.contains(versions["."]) for one in siblings.values())


@pytest.mark.parametrize("folder", FOLDERS)
def test_pinned_versions_lie_in_the_ranges(folder: str) -> None:
    known = pinned()
    for wanted in requirements(folder):
        name = canonicalize_name(wanted.name)
        if name.startswith("endonav"):
            continue
        assert name in known, f"{wanted} is not pinned in constraints.txt"
        assert wanted.specifier.contains(known[name]), wanted


@pytest.mark.parametrize("folder", FOLDERS[1:])
def test_every_distribution_brings_the_licence(folder: str) -> None:
    licence = (PROJECT_ROOT / folder / "LICENSE").read_text(encoding="utf-8")
    assert licence == (PROJECT_ROOT / "LICENSE").read_text(encoding="utf-8")
