"""Trees, tables, contents and the site list all that there is."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.integration.documents.pages import (
    ARCHITECTURE,
    DOCS,
    PACKAGES,
    PAGES,
    PROJECT_ROOT,
    STAGES,
    code_blocks,
    package_folders,
    read,
    relative,
    resolves,
    table_column,
)

TABLES = DOCS / "pipeline" / "tables.md"
CONTENTS = DOCS / "index.md"


def listed_folders() -> set[str]:
    """The folders that the tree of the architecture page lists, as paths from the repository's root."""
    tree = next(block for block in code_blocks(read(ARCHITECTURE)) if "packages/cathsim/src/cathsim/" in block)
    listed: set[str] = set()
    parents: list[str] = []
    for line in tree.splitlines():
        if found := re.match(r"( *)([\w./-]+)/ ", line):
            depth = len(found[1]) // 2
            parents = [*parents[:depth], found[2]]
            listed.add("/".join(parents))
    return listed


def test_tree_of_the_architecture_is_that_of_the_repository() -> None:
    listed = listed_folders()
    assert not sorted(folder for folder in listed if not (PROJECT_ROOT / folder).is_dir())
    for package in (*PACKAGES, "pipeline"):
        root, folders = package_folders(package)
        base = relative(root)
        assert {base, *(f"{base}/{folder}" for folder in folders)} <= listed
    for parent in ("docs", "tests", "benchmarks", "conf"):
        kept = {relative(path) for path in (PROJECT_ROOT / parent).iterdir() if path.is_dir() and any(path.glob("*.*"))}
        assert kept - {f"{parent}/__pycache__"} <= listed


def test_tables_of_stages_are_complete() -> None:
    for document in (ARCHITECTURE, DOCS / "pipeline" / "stages.md"):
        listed = [cell.strip("`") for cell in table_column(read(document), "stage")]
        assert set(listed) == STAGES, relative(document)
        assert len(listed) == len(STAGES)


def test_every_table_of_the_report_is_listed_with_its_stage_and_module() -> None:
    tables = yaml.safe_load(read(PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml"))["tables"]
    rows = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in read(TABLES).splitlines()]
    listed = {row[0]: row[1:] for row in rows if row and row[0] in tables}
    assert listed.keys() == tables.keys()
    for name, (title, _, stage, module) in listed.items():
        assert (title, stage) == (tables[name]["title"], tables[name].get("stage", "")), name
        source = importlib.util.find_spec(module)
        assert source, module
        assert f'"{name}"' in read(Path(str(source.origin))), f"{module} makes no table {name}"


def test_every_page_of_the_documents_is_listed_in_the_contents() -> None:
    text = read(CONTENTS)
    pages = [page.relative_to(DOCS).as_posix() for page in PAGES if page != CONTENTS]
    assert not [page for page in pages if f"]({page})" not in text]
    assert "](docs/index.md)" in read(PROJECT_ROOT / "README.md")


def nav_pages(entry: object) -> Iterator[str]:
    """The pages of a part of the site's navigation."""
    if isinstance(entry, str):
        yield entry
    for part in entry if isinstance(entry, list) else entry.values() if isinstance(entry, dict) else ():
        yield from nav_pages(part)


def test_the_site_s_navigation_has_every_page_once() -> None:
    listed = list(nav_pages(yaml.safe_load(read(PROJECT_ROOT / "mkdocs.yml"))["nav"]))
    pages = {page.relative_to(DOCS).as_posix() for page in PAGES}
    assert len(listed) == len(set(listed))
    assert pages <= set(listed)
    outside = {"about.md", "tutorial.md", "models.md", "contributing.md", "changelog.md"}
    outside |= {f"{folder}/{package}.md" for folder in ("packages", "api") for package in PACKAGES}
    assert set(listed) - pages == outside


def test_every_film_is_shown_and_small() -> None:
    films = sorted((DOCS / "pictures").rglob("*.gif"))
    shown = read(DOCS / "gallery.md")
    assert films
    for film in films:
        assert f"]({film.relative_to(DOCS).as_posix()})" in shown
        assert film.stat().st_size < 1_000_000, relative(film)


def test_readme_lists_every_folder_of_the_repository() -> None:
    tree = next(block for block in code_blocks(read(PROJECT_ROOT / "README.md")) if "pipeline/ " in block)
    listed = set(re.findall(r"^([\w./]+)/ ", tree, re.MULTILINE))
    assert listed == {"packages/" + package for package in PACKAGES} | {
        "pipeline",
        "conf",
        "docs",
        "tests",
        "benchmarks",
        "examples",
        "models",
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_table_of_modules_covers_the_package(package: str) -> None:
    text = read(PROJECT_ROOT / "packages" / package / "README.md")
    named = {name for cell in table_column(text, "module") for name in re.findall(r"`([\w.]+)`", cell)}
    assert not sorted(name for name in named if not resolves(name))
    _, folders = package_folders(package)
    top = {f"{package}.{folder}" for folder in folders if "/" not in folder}
    assert not sorted(top - named)
