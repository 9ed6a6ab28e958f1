"""The documents tell the truth: their code runs, its asserts hold, and their tables are those of the code."""

from __future__ import annotations

import math
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


def rows(document: Path, *columns: str) -> dict[str, dict[str, str]]:
    """The table with these columns, by its first one."""
    lines = document.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines):
        header = [cell.strip() for cell in line.strip("|").split("|")]
        if set(columns) <= set(header) and line.startswith("|"):
            table = {}
            for row in lines[number + 2 :]:
                if not row.startswith("|"):
                    return table
                cells = [cell.strip() for cell in row.strip("|").split("|")]
                table[cells[0].strip("`")] = dict(zip(header, cells, strict=True))
            return table
    raise AssertionError(f"{document.name} has no table with the columns {columns}")


def test_table_of_wires_is_that_of_the_code() -> None:
    from cathsim import GUIDEWIRES

    table = rows(SIMULATOR, "links", "diameter, mm", "EI shaft, N·mm²", "EI tip, N·mm²", "tip", "friction")
    assert table.keys() == GUIDEWIRES.keys()
    for name, wire in GUIDEWIRES.items():
        row = table[name]
        assert int(row["links"]) == len(wire.links)
        assert float(row["diameter, mm"]) == pytest.approx(1e3 * wire.diameter)
        assert float(row["EI shaft, N·mm²"]) == wire.shaft_stiffness_nmm2
        assert float(row["EI tip, N·mm²"]) == wire.tip_stiffness_nmm2
        assert float(row["friction"]) == wire.friction
        angle, length = math.degrees(wire.tip_angle), 1e3 * wire.tip_length
        assert row["tip"] == ("straight" if wire.tip_angle == 0 else f"{angle:.0f}° over {length:.0f} mm")


def test_table_of_accuracies_is_that_of_the_code() -> None:
    from cathsim import ACCURACY

    columns = ("substep, ms", "repeated in", "tolerance, mm", "rise, mm", "mass factor", "with a catheter in")
    table = rows(SIMULATOR, *columns)
    assert table.keys() == ACCURACY.keys()
    for name, numerics in ACCURACY.items():
        values = [float(cell) for column, cell in table[name].items() if column != "preset"]
        assert values == pytest.approx(
            [
                1e3 * numerics.timestep,
                numerics.refinement,
                1e3 * numerics.tolerance,
                1e3 * numerics.rise,
                numerics.mass_scale,
                numerics.with_catheter.refinement,
            ]
        )
