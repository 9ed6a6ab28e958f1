"""The documents tell the truth: their code runs, its asserts hold, and their tables are those of the code."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT_ROOT = Path(__file__).resolve().parents[2]
CONVENTIONS = PROJECT_ROOT / "docs" / "conventions.md"
SIMULATOR = PROJECT_ROOT / "docs" / "cathsim" / "simulator.md"
README = PROJECT_ROOT / "packages" / "cathsim" / "README.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(document: Path) -> Iterator[tuple[int, str]]:
    """Number of the first line and text of each Python block."""
    text = document.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        yield text[: match.start(1)].count("\n"), match.group(1)


def run(document: Path) -> int:
    """Runs a document's blocks in one namespace, as a reader would type them; returns how many asserts there were."""
    namespace: dict[str, object] = {"__name__": document.stem}
    asserts = 0
    for line, text in blocks(document):
        # the empty lines make a traceback point at the line of the document
        exec(compile("\n" * line + text, str(document), "exec"), namespace)
        asserts += len(re.findall(r"^\s*assert ", text, re.MULTILINE))
    return asserts


def test_conventions_hold() -> None:
    assert run(CONVENTIONS) > 40


def test_readme_of_the_simulator_runs() -> None:
    run(README)


@pytest.mark.parametrize("page", sorted(SIMULATOR.parent.glob("*.md")), ids=lambda page: page.stem)
def test_pages_of_the_simulator_run(page: Path) -> None:
    if page.stem == "mujoco":
        pytest.importorskip("dm_control")
    run(page)
