"""The table of stages and the site list all that there is."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from tests.integration.documents.pages import (
    DOCS,
    PACKAGES,
    PAGES,
    PROJECT_ROOT,
    STAGES,
    read,
    table_column,
)


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
