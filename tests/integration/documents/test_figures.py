"""The readme's figures are those of the pages that it names, and each has its interval."""

from __future__ import annotations

import re

import pytest

from tests.integration.documents.pages import PROJECT_ROOT, read


def readme_lines(heading: str) -> list[str]:
    """The points of a section of the readme."""
    section = re.search(rf"^## {heading}\n(.*?)^## ", read(PROJECT_ROOT / "README.md"), re.DOTALL | re.MULTILINE)
    assert section
    return re.findall(r"^- .*$", section[1], re.MULTILINE)


NEWS, LIMITS = readme_lines("What is new"), readme_lines("Limits")


@pytest.mark.parametrize("line", [*NEWS, *LIMITS], ids=lambda line: line[4:30])
def test_figures_of_the_readme_are_those_of_the_results(line: str) -> None:
    (link,) = re.findall(r"\]\((docs/results/[\w.]+)\)", line)
    figures = re.findall(r"\d+(?:\.\d+)?", re.sub(r"\]\([^)]*\)|\*\*.*?\*\*|95 %|Simmons 2", "", line))
    measured = set(re.findall(r"\d+(?:\.\d+)?", read(PROJECT_ROOT / link)))
    assert figures
    assert not sorted(set(figures) - measured)
    assert line in LIMITS or re.search(r"\(\d[\d.]* to \d[\d.]*\)", line), "an interval"
