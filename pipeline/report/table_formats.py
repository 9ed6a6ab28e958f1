"""Tables as text: the words of a cell, CSV, and LaTeX with booktabs."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

from pipeline.report.results import Cell

if TYPE_CHECKING:
    from pipeline.report.tables import ReportTable, Row  # a stage that words its own cells does not read the thesis's

_LATEX = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
          "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "≥": r"$\geq$", "×": r"$\times$",
          "²": r"$^2$", "τ": r"$\tau$", "γ": r"$\gamma$", "–": "--"}  # fmt: skip


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


def _cells(table: ReportTable, row: Row) -> list[str]:
    """Thesis's and measured cell of each column, in words."""
    return [format_cell(side.get(c.key), c.decimals) for c in table.columns for side in (row.thesis, row.measured)]


def as_csv(table: ReportTable) -> str:
    """Writes a table as CSV: two columns each, thesis and measured; cells that have not run are empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    head = [f"{c.key}{suffix}" for c in table.columns for suffix in ("_thesis", "_measured")]
    writer.writerow(["row", *head, "samples"])
    for row in table.rows:
        writer.writerow([row.key, *_cells(table, row), row.samples if row.samples is not None else ""])
    return stream.getvalue()


def as_latex(table: ReportTable) -> str:
    """Writes a ``table`` environment: thesis and measured value beside each other; dashes for what has not run."""
    width = len(table.columns)
    heads = [_escape(f"{c.label}{f', {c.unit}' if c.unit else ''}") for c in table.columns]
    lines = [
        r"\begin{table}[ht]", r"\centering", rf"\caption{{{_escape(table.title)}}}\label{{tab:{table.key}}}",
        r"\begin{tabular}{l" + " rr" * width + "}", r"\toprule",
        " & ".join(["", *(rf"\multicolumn{{2}}{{c}}{{{head}}}" for head in heads)]) + r" \\",
        " & ".join(["", *["thesis & measured"] * width]) + r" \\", r"\midrule",
    ]  # fmt: skip
    group = ""
    for row in table.rows:
        if row.group != group:
            group = row.group
            lines.append(rf"\multicolumn{{{1 + 2 * width}}}{{l}}{{\textit{{{_escape(group)}}}}} \\")
        cells = [_escape(cell) or "--" for cell in _cells(table, row)]
        lines.append(" & ".join([_escape(row.label), *cells]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _escape(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
