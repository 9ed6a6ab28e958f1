"""Trees, tables, contents and the site list all that there is."""

from __future__ import annotations

import re
from collections.abc import Iterator

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
    table_column,
)


def listed_folders() -> set[str]:
    """The folders that the tree of the architecture page lists, as paths from the repository's root."""
    tree = next(block for block in code_blocks(read(ARCHITECTURE)) if "packages/cathsim/src/cathsim/" in block)
    listed: set[str] = set()
    parents: list[str] = []
    for line in tree.splitlines():
        if found := re.match(r"( *)([\w./-]+)/(?: |$)", line):
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


def test_table_of_stages_is_complete() -> None:
    listed = [cell.strip("`") for cell in table_column(read(DOCS / "pipeline" / "stages.md"), "stage")]
    assert sorted(listed) == sorted(STAGES)


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
