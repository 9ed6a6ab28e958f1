"""Length and wording of the documents; figures have their command, and those of the readme a page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from tests.integration.documents.pages import (
    PAGES,
    PROJECT_ROOT,
    WORD_LIMIT,
    code_blocks,
    documents,
    read,
    relative,
)

# Words that have a plain one in the field's language.
UNWANTED = re.compile(
    r"\b(eyes?|lessons?|pupils?|judgements?|intake|drift(?:s|ed)?|ink|clumsy|likewise|at a desk|spares? the wall"
    r"|what is odd|told|foretold|anew|memory's)\b",
    re.IGNORECASE,
)


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name != "results"], ids=relative)
def test_page_is_short(page: Path) -> None:
    assert len(read(page).split()) <= WORD_LIMIT


@documents
def test_words_are_plain(document: Path) -> None:
    assert not sorted({found[0] for found in UNWANTED.finditer(read(document))})


def test_a_word_that_is_not_plain_is_found() -> None:
    assert UNWANTED.search("the navigator's eye")


def readme_lines(heading: str) -> list[str]:
    """The points of a section of the readme."""
    section = re.search(rf"^## {heading}\n(.*?)^## ", read(PROJECT_ROOT / "README.md"), re.DOTALL | re.MULTILINE)
    assert section
    return re.findall(r"^- .*$", section[1], re.MULTILINE)


NEWS, LIMITS = readme_lines("What is new"), readme_lines("Limits")


@pytest.mark.parametrize("line", [*NEWS, *LIMITS], ids=lambda line: line[4:30])
def test_figures_of_the_readme_stand_in_the_results(line: str) -> None:
    (link,) = re.findall(r"\]\((docs/results/[\w.]+)\)", line)
    figures = re.findall(r"\d+(?:\.\d+)?", re.sub(r"\]\([^)]*\)|\*\*.*?\*\*|95 %|Simmons 2", "", line))
    found = set(re.findall(r"\d+(?:\.\d+)?", read(PROJECT_ROOT / link)))
    assert figures
    assert not sorted(set(figures) - found)
    assert line in LIMITS or re.search(r"\(\d[\d.]* to \d[\d.]*\)", line), "an interval"


def test_readme_is_short_and_shows_a_small_film() -> None:
    text = read(PROJECT_ROOT / "README.md")
    assert len(text.split()) <= 900
    before_news = text.split("## What is new")[0]
    (film,) = re.findall(r"!\[[^\]]+\]\(([^)]+\.gif)\)", before_news)
    assert (PROJECT_ROOT / film).stat().st_size < 1_000_000
    assert len(NEWS) == 5
    assert len(LIMITS) >= 2
    commands = [line.split("#")[0].strip() for line in code_blocks(text)[0].splitlines()]
    assert commands == ["make demo", "make all", "make test"]


def test_the_thesis_is_cited() -> None:
    citation = yaml.safe_load(read(PROJECT_ROOT / "CITATION.cff"))
    (thesis,) = citation["references"]
    (author,) = thesis["authors"]
    cited = (author["given-names"], author["family-names"], thesis["title"], thesis["institution"]["name"])
    assert all(part in read(PROJECT_ROOT / "README.md").replace("\n", " ") for part in (*cited, str(thesis["year"])))
    version = re.search(r'^version = "(.+)"$', read(PROJECT_ROOT / "pyproject.toml"), re.MULTILINE)
    assert version
    assert citation["version"] == version[1]


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name == "results"], ids=relative)
def test_measured_figures_have_a_command_or_a_commit(page: Path) -> None:
    said = re.compile(r"^```|ot recorded|ommits? (?:as|before|above)|`[0-9a-f]{7,8}`", re.MULTILINE)
    introduction, *sections = re.split(r"^## ", read(page), flags=re.MULTILINE)
    if not said.search(introduction):
        assert sections
        assert not [section.splitlines()[0] for section in sections if not said.search(section)]
