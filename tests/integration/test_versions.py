"""Distributions: one version, pinned ranges, declared extras, modules that packages carry alike."""

import importlib.metadata
import json
import sys
import tomllib
from collections.abc import Callable
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.integration.documents.pages import PACKAGES, PROJECT_ROOT
from tests.integration.source_imports import imports_of

FOLDERS = (".", *(f"packages/{name}" for name in PACKAGES))


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


def test_all_have_one_version_and_bring_the_licence() -> None:
    versions = {folder: project(folder)["version"] for folder in FOLDERS}
    assert len(set(versions.values())) == 1, versions
    siblings = {one.name: one for one in requirements(".") if one.name.startswith("endonav-")}
    assert set(siblings) == {project(folder)["name"] for folder in FOLDERS[1:]}
    assert all(one.specifier.contains(versions["."]) for one in siblings.values())
    assert len({(PROJECT_ROOT / folder / "LICENSE").read_text(encoding="utf-8") for folder in FOLDERS}) == 1


def test_the_command_brings_what_its_verbs_need() -> None:
    """NIfTI for `endonav import`, the browser's page for `endonav console`, torch for `endonav read`."""
    extras = {one.name: one.extras for one in map(Requirement, project(".")["dependencies"])}
    assert extras["endonav-cathsim"] >= {"console", "volumes"}
    assert extras["endonav-guide3d"] >= {"learning"}


@pytest.mark.parametrize("folder", FOLDERS)
def test_pinned_versions_lie_in_the_ranges(folder: str) -> None:
    known = pinned()
    for wanted in requirements(folder):
        name = canonicalize_name(wanted.name)
        if name.startswith("endonav"):
            continue
        assert name in known, f"{wanted} is not pinned in constraints.txt"
        assert wanted.specifier.contains(known[name]), wanted


# distribution[extra], module that is missing, what needs it
USES = [
    ("cathsim[composer]", "dm_control", "import cathsim.composer"),
    ("cathsim[hulls]", "coacd", "from cathsim.contact.hulls import decompose; decompose(None, None)"),
    ("cathsim[human]", "pygame", "from cathsim.viewing.display import Window; Window()"),
    ("cathsim[metaimage]", "SimpleITK", "import cathsim; cathsim.import_anatomy('labels.mha')"),
    ("cathsim[pictures]", "matplotlib", "from cathsim.viewing.figure import new_figure; new_figure()"),
    ("cathsim[pictures]", "PIL", "from cathsim.viewing.film import film_palette; film_palette([], 2, 2)"),
    (
        "cathsim[surfaces]",
        "lz4",
        "from cathsim.anatomy.mesh.files.vtp import _unpacker as u; u('vtkLZ4DataCompressor')",
    ),
    (
        "cathsim[dicom]",
        "pydicom",
        "from cathsim.anatomy.volume.dicom.files import read_dicom as r; r(pathlib.Path('run.dcm'))",
    ),
    ("cathsim[volumes]", "nibabel", "import cathsim; cathsim.import_anatomy('labels.nii.gz')"),
    ("cathsim[volumes]", "nrrd", "import cathsim; cathsim.import_anatomy('labels.nrrd')"),
    ("guide3d[dicom]", "pydicom", "from guide3d.dicom.run_folder import read_xray; read_xray('run.dcm')"),
    ("guide3d[learning]", "torch", "import guide3d, numpy; guide3d.read(numpy.eye(256))"),
    ("guide3d[learning]", "torch", "import guide3d; guide3d.load('reader')"),
    ("guide3d[learning]", "torch", "import guide3d.train"),
    ("guide3d[learning]", "torch", "import guide3d.train_reader"),
    ("guide3d[learning]", "torch", "import guide3d.modeling.unet"),
    ("guide3d[learning]", "torch", "import guide3d.reading.maps"),
    ("enn[onnx]", "onnx", "from enn.export import _require; _require('onnx')"),
    ("enn[wandb]", "wandb", "from pathlib import Path; from enn.curves import open_writer as o; o(Path('f'), 'wandb')"),
    ("splineformer[onnx]", "onnx", "from splineformer.export import _require; _require('onnx')"),
]
FILES = ("labels.mha", "labels.nii.gz", "labels.nrrd", "run.dcm")
# console: a line of its own command (tests/cathsim/console); lossless: found by pydicom (tests/guide3d/dicom);
# video: Gymnasium's own wrapper names moviepy
ELSEWHERE = {"cathsim[console]", "cathsim[video]", "guide3d[lossless]"}


# Each use is tried in a process forked from one that has imported what takes long and is no extra.
EACH_USE = """
import json, os, pathlib, sys, tempfile
import gymnasium, mujoco, pydantic, scipy.ndimage, scipy.spatial, skimage.measure, trimesh
os.chdir(tempfile.mkdtemp())
for name in FILES:
    pathlib.Path(name).write_bytes(b"0")
for number, (extra, module, use) in enumerate(USES):
    if extra.startswith("enn"):
        import torch  # which is no extra from here on
    if not os.fork():
        sys.modules[module] = None
        try:
            exec(use)
        except Exception as error:
            pathlib.Path(f"{number}.json").write_text(json.dumps(str(error)))
        os._exit(0)
    os.wait()
print(json.dumps([json.loads(pathlib.Path(f"{number}.json").read_text()) for number in range(len(USES))]))
"""


def test_a_missing_dependency_is_named_with_its_extra(run_python: Callable[[str], str]) -> None:
    sentences = json.loads(run_python(f"FILES, USES = {FILES!r}, {USES!r}\n{EACH_USE}").splitlines()[-1])
    for (extra, _, use), said in zip(USES, sentences, strict=True):
        assert f"pip install 'endonav-{extra}'" in said.replace('"', "'"), use
        assert "\n" not in said


def test_every_extra_of_the_packages_is_tried() -> None:
    extras = {package: project(f"packages/{package}").get("optional-dependencies", ()) for package in PACKAGES}
    declared = {f"{package}[{extra}]" for package in PACKAGES for extra in extras[package]}
    assert declared == {extra for extra, _, _ in USES} | ELSEWHERE


# comes with another one that is declared
BROUGHT = {"dm_env": "dm_control"}


@pytest.mark.parametrize("package", PACKAGES)
def test_what_a_package_imports_is_declared(package: str) -> None:
    declared = {canonicalize_name(one.name) for one in requirements(f"packages/{package}")}
    sources = (PROJECT_ROOT / "packages" / package / "src").rglob("*.py")
    imported = {one.module.split(".")[0] for file in sources for one in imports_of(file) if not one.for_types}
    foreign = imported - {package, *sys.stdlib_module_names}
    brings = importlib.metadata.packages_distributions()
    missing = {
        name
        for name in foreign
        if not {one.lower().replace("_", "-") for one in brings.get(BROUGHT.get(name, name), [name])} & declared
    }
    assert not missing


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("guarded_reading.py", "cathsim/src/cathsim"),
        ("bounded_content.py", "enn/src/enn"),
        ("lazy_names.py", "guide3d/src/guide3d"),
        ("opencv.py", "guide3d/src/guide3d"),
    ],
)
def test_packages_carry_the_same_module(name: str, package: str):
    copies = sorted((PROJECT_ROOT / "packages").glob(f"*/src/**/{name}"))
    assert PROJECT_ROOT / "packages" / package / name in copies
    assert len(copies) > 1
    assert len({copy.read_bytes() for copy in copies}) == 1
