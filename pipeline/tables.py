"""The contract between stages and the report: what a stage leaves in its folder to be shown.

``results.json`` holds measured cells, nested by table, row and column::

    {"ablation": {"bca/I+V+M": {"force_n": [0.12, 0.03], "success_pct": 95.0, "n": 20}}}

- Tables, rows and columns are those of ``thesis.yaml``. A row the thesis does not have is shown below the table's
  others, a table it does not have below the others; both appear under their keys unless ``thesis.yaml`` labels them.
- Rows of a grouped table are ``group/row``: ``type_1/ppo_internal``, ``bca/H``.
- A cell is a number, a pair ``[mean, standard deviation]``, or text. A cell that is absent or null has not run.
- ``n`` is no column: it is the number of samples behind the row's pairs, e.g. evaluation episodes.

``figures.json`` lists pictures and films, in the order they are shown::

    [{"title": "Phantom type_1", "caption": "Lumen from the front.", "file": "type_1/picture.png"}]

``file`` is relative to the stage's folder: PNG, JPEG, GIF, WebP, SVG, MP4 or WebM. ``group`` (optional) heads several
figures; ``stage`` (optional) is the stage beside whose tables it is shown, where that is another one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.errors import StageError

RESULTS = "results.json"
NOTES = "notes.json"  # table -> how its rows were made, shown beneath it
FIGURES = "figures.json"
SAMPLES = "n"

Cell = float | int | str | list[float] | None
Table = dict[str, dict[str, Cell]]  # row -> column -> cell


@dataclass(frozen=True)
class Figure:
    """A picture or a film a stage wants shown."""

    title: str
    caption: str
    file: str  # relative to the stage's folder
    group: str = ""
    stage: str = ""  # beside whose tables it is shown; "": that of the folder


@dataclass(frozen=True)
class Results:
    """What a stage measured and drew."""

    tables: Mapping[str, Any]  # measured cells: table -> row -> column -> cell
    # Figures in the order in which they are shown, with files in the stage's folder; None: the stage draws none.
    figures: Sequence[Figure] | None = None
    notes: Mapping[str, str] = field(default_factory=dict)  # table -> how its rows were made

    def write(self, folder: Path) -> None:
        """Leaves them in the stage's folder; errors name what is no cell, and a figure without file."""
        write_results(folder, self.tables)
        if self.notes:
            write_json(folder / NOTES, self.notes)
        if self.figures is not None:
            write_figures(folder, self.figures)


def _read(path: Path, otherwise: Any) -> Any:
    try:
        return read_json(path) if path.is_file() else otherwise
    except ValueError as error:
        raise StageError(f"{path} is damaged ({error}): run its stage again with force=true") from error


def write_results(folder: Path, tables: Mapping[str, Any]) -> None:
    """Writes measured cells: table -> row -> column -> cell; a ValueError names what is no cell."""
    for table, rows in tables.items():
        for row, columns in rows.items():
            for column, cell in columns.items():
                check_cell(cell, f"{table} / {row} / {column}")
    write_json(folder / RESULTS, tables)


def read_notes(folder: Path) -> dict[str, str]:
    """Reads what a stage says of its tables; empty when it says nothing."""
    return _read(folder / NOTES, {})


def write_figures(folder: Path, figures: Sequence[Figure]) -> None:
    """Writes a stage's list of figures, in the order they are shown; each must have its file in the folder."""
    for figure in figures:
        if not (folder / figure.file).is_file():
            raise FileNotFoundError(f"figure {figure.title!r} names {figure.file}, which is not in {folder}")
    write_json(folder / FIGURES, [asdict(figure) for figure in figures])


def read_results(folder: Path) -> dict[str, Table]:
    """Reads a stage's measured cells; empty when it measures nothing."""
    return _read(folder / RESULTS, {})


def read_figures(folder: Path) -> list[Figure]:
    """Reads a stage's list of figures: those whose files are there."""
    figures = [Figure(**entry) for entry in _read(folder / FIGURES, [])]
    return [figure for figure in figures if (folder / figure.file).is_file()]


def check_cell(cell: Any, place: str) -> None:
    """Refuses, with its place, what is neither a finite number, nor a pair of such, nor text, nor None."""
    numbers = cell if isinstance(cell, list | tuple) else [] if cell is None or isinstance(cell, str) else [cell]
    is_pair = not isinstance(cell, list | tuple) or len(cell) == 2
    if not is_pair or not all(isinstance(x, int | float) and math.isfinite(x) for x in numbers):
        raise ValueError(f"{place}: expected a finite number, a pair [mean, sd], text or null, got {cell!r}")


def mean_of(cell: Cell) -> float:
    """The number of a cell, or the mean of its pair; a TypeError for text, or nothing."""
    if isinstance(cell, str) or cell is None:
        raise TypeError(f"expected a number or a pair, got {cell!r}")
    return float(cell[0] if isinstance(cell, list) else cell)


def format_cell(cell: Cell, decimals: int | None = None) -> str:
    """Words a cell with so many decimals, or with as many as the value needs; nothing for None."""
    if cell is None:
        return ""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, list):
        places = _decimals(max(map(abs, cell))) if decimals is None else decimals
        return f"{cell[0]:.{places}f} ± {cell[1]:.{places}f}"
    if decimals is not None:
        return f"{cell:.{decimals}f}"
    if float(cell).is_integer():
        return f"{int(cell):,}" if abs(cell) >= 10_000 else str(int(cell))
    return f"{cell:.4g}"


def _decimals(value: float) -> int:
    """Enough decimals for three to four significant digits."""
    magnitude = math.floor(math.log10(abs(value))) if value else 0
    return max(0, min(4, 2 - magnitude))


def pool(cells: list[tuple[Cell, int | None]]) -> tuple[Cell, int | None]:
    """Joins the same cell from several jobs of a sweep, e.g. one a seed.

    Numbers become mean and standard deviation over the jobs, unless they are one setting that all share. Pairs with
    known sample counts are pooled as if their samples lay in one list; without counts every job weighs the same. The
    count is that of all samples, of the jobs where samples are not known.
    """
    known = [(cell, n) for cell, n in cells if cell is not None]
    if len(known) <= 1:
        return known[0] if known else (None, None)
    if any(isinstance(cell, str) for cell, _ in known):
        texts = dict.fromkeys(str(cell) for cell, _ in known)
        return "; ".join(texts), None
    if all(isinstance(cell, list) for cell, _ in known) and all(n for _, n in known):
        return _pool_samples([(cell, n) for cell, n in known if isinstance(cell, list) and n])
    same = len({repr(cell) for cell, _ in known}) == 1 and not any(n for _, n in known)
    if same and not isinstance(known[0][0], list):
        return known[0][0], None  # a setting that every job shares
    means = [float(cell[0] if isinstance(cell, list) else cell) for cell, _ in known if not isinstance(cell, str)]
    mean = math.fsum(means) / len(means)
    spread = math.sqrt(math.fsum((x - mean) ** 2 for x in means) / len(means))
    return [mean, spread], sum(n for _, n in known if n) if all(n for _, n in known) else len(means)


def _pool_samples(cells: list[tuple[list[float], int]]) -> tuple[Cell, int]:
    total = sum(n for _, n in cells)
    mean = math.fsum(m * n for (m, _), n in cells) / total
    variance = math.fsum(n * (s**2 + (m - mean) ** 2) for (m, s), n in cells) / total
    return [mean, math.sqrt(variance)], total
