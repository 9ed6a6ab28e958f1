"""Import isolation: who may import whom, by the sources and by what an import really loads."""

import graphlib
import importlib
import inspect
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.integration.documents.pages import PACKAGES, PROJECT_ROOT
from tests.integration.source_imports import imports_of

# package -> the project's packages it may import
ALLOWED = {
    "cathsim": set(),
    "enn": set(),
    "guide3d": set(),
    "splineformer": {"guide3d"},
    "pipeline": {"cathsim", "enn", "guide3d", "splineformer"},
}
FORBIDDEN_MODULE_NAMES = {"utils", "util", "common", "helpers", "helper", "misc", "fn"}


def source_root(package: str) -> Path:
    return PROJECT_ROOT / "pipeline" if package == "pipeline" else PROJECT_ROOT / "packages" / package / "src" / package


def sources(package: str) -> list[Path]:
    found = sorted(source_root(package).rglob("*.py"))
    assert found, f"no sources of {package}: has it moved?"
    return found


def imported_modules(file: Path) -> Iterator[str]:
    """Yields what every import names, also those inside functions and of import_module("...")."""
    yield from (f"{one.module}.{one.name}" if one.name else one.module for one in imports_of(file))


def imported_packages(file: Path) -> Iterator[str]:
    """Yields the top-level package of every import."""
    yield from (name.split(".")[0] for name in imported_modules(file))


@pytest.mark.parametrize("package", list(ALLOWED))
def test_package_imports_only_what_it_may_and_no_module_is_called_after_nothing(package: str) -> None:
    names = {file.stem for file in sources(package)} | {file.parent.name for file in sources(package)}
    assert not names & FORBIDDEN_MODULE_NAMES
    others = set(ALLOWED) - {package}
    offences = [
        f"{file.relative_to(PROJECT_ROOT)} imports {name}"
        for file in sources(package)
        for name in imported_packages(file)
        if name in others - ALLOWED[package]
    ]
    assert not offences


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [
        (source_root("pipeline") / "episodes", {"cathsim", "mujoco", "torch", "hydra", "omegaconf"}),
        (source_root("guide3d") / "geometry", {"torch", "torchvision", "timm"}),
    ],
    ids=["logs without simulator and learning", "geometry without learning"],
)
def test_a_part_of_a_package_needs_less_than_the_whole(folder: Path, forbidden: set[str]) -> None:
    files = sorted(folder.rglob("*.py"))
    assert len(files) >= 7
    assert not forbidden & {name for file in files for name in imported_packages(file)}


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("cathsim", {"torch", "stable_baselines3", "hydra", "matplotlib", "dm_control", "enn", "guide3d", "pipeline"}),
        ("guide3d", {"mujoco", "torch", "cathsim", "pipeline"}),
        ("enn", {"cathsim", "guide3d", "splineformer", "pipeline", "mujoco"}),
        ("splineformer", {"cathsim", "enn", "pipeline", "mujoco"}),
        ("pipeline", {"cathsim", "torch", "mujoco"}),
    ],
)
def test_import_loads_nothing_it_should_not(
    package: str, forbidden: set[str], run_python: Callable[[str], str]
) -> None:
    # what the modules of the geometry import in turn counts, too
    geometry = [f"guide3d.geometry.{path.stem}" for path in (source_root("guide3d") / "geometry").glob("[!_]*.py")]
    names = ", ".join([package, *(geometry if package == "guide3d" else ())])
    snippet = f"import {names}, json, sys; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    loaded = set(json.loads(run_python(snippet)))
    assert package in loaded
    assert not loaded & forbidden


LAZY = sorted(
    ".".join([package, *file.parent.relative_to(source_root(package)).parts])
    for package in PACKAGES
    for file in source_root(package).rglob("__init__.py")
    if "lazy_names(" in file.read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def shown_names(run_python: Callable[[str], str]) -> dict[str, list[str]]:
    """What `dir` shows of each package right after its import, in one process."""
    imports = f"{{name: dir(importlib.import_module(name)) for name in {LAZY}}}"
    found: dict[str, list[str]] = json.loads(run_python(f"import importlib, json; print(json.dumps({imports}))"))
    return found


@pytest.mark.parametrize("package", LAZY)
def test_public_names_are_shown_before_their_first_use_and_are_there(
    package: str, shown_names: dict[str, list[str]]
) -> None:
    shown = shown_names[package]
    module = importlib.import_module(package)
    assert shown == sorted(module.__all__)
    assert len(shown) >= 4
    for name in shown:
        value = getattr(module, name)
        if callable(value):
            assert value.__module__.startswith(package.split(".")[0])
        # the import system binds a submodule to its package, over a lazy name that is the same
        assert not inspect.ismodule(value)
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


def test_no_module_imports_itself_through_others_not_even_for_types_or_in_a_function() -> None:
    files = {}
    for package in ALLOWED:
        for file in sources(package):
            parts = [package, *file.relative_to(source_root(package)).with_suffix("").parts]
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    graph: dict[str, set[str]] = {}
    for name, file in files.items():
        # a package's __init__ names for type checkers what it imports at first use
        found = [one for one in imports_of(file) if one.at_load or file.name != "__init__.py"]
        modules = {whole if (whole := f"{one.module}.{one.name}") in files else one.module for one in found}
        graph[name] = (modules & files.keys()) - {name}
    assert sum(map(len, graph.values())) > len(files)
    list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names the circle
