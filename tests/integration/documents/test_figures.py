"""The readme's figures are those of the pages that it names, and each has its interval."""

from __future__ import annotations

import re

import pytest

from tests.integration.documents.pages import PROJECT_ROOT, read

README = read(PROJECT_ROOT / "README.md")
ROWS = re.findall(r"^\| .*\]\(docs/results/.*\|$", README, re.MULTILINE)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[3:30])
def test_figures_of_the_readme_are_those_of_the_results(row: str) -> None:
    (link,) = re.findall(r"\]\((docs/results/[\w.]+)\)", row)
    figures = re.findall(r"\d+(?:\.\d+)?", re.sub(r"\]\([^)]*\)", "", row))
    assert not sorted(set(figures) - set(re.findall(r"\d+(?:\.\d+)?", read(PROJECT_ROOT / link))))
    assert re.search(r"\(\d[\d.]* to \d[\d.]*\)", row), "an interval"


def test_the_readme_is_read_in_two_minutes() -> None:
    assert len(ROWS) == 5
    assert len(README.split()) <= 450
