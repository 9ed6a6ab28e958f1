"""Tables as text: CSV, and LaTeX with booktabs."""

from __future__ import annotations

import csv
import io

from pipeline.report.intervals import OverSeeds
from pipeline.report.tables import ReportTable, Row
from pipeline.tables import Cell, format_cell

_LATEX = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
          "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "≥": r"$\geq$", "×": r"$\times$",
          "²": r"$^2$", "τ": r"$\tau$", "γ": r"$\gamma$", "–": "--"}  # fmt: skip


def format_over_seeds(found: OverSeeds, decimals: int | None = None) -> str:
    """Words a figure over run seeds: ``3 seeds: 91.1 (88.0 to 94.2)``, with the 95 % interval of the mean."""
    mean, low, high = (format_cell(float(value), decimals) for value in (found.cell[0], *found.interval))
    return f"{found.seeds} seeds: {mean} ({low} to {high})"


def _cells(table: ReportTable, row: Row) -> list[str]:
    """Thesis's and measured cell of each column, in words."""
    return [format_cell(side.get(c.key), c.decimals) for c in table.columns for side in (row.thesis, row.measured)]


def as_csv(table: ReportTable) -> str:
    """Writes a table as CSV: two columns each, thesis and measured; cells that have not run are empty.

    Where stages ran with several seeds, three columns more of each such figure: mean over seeds and its 95 % interval.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    head = [f"{c.key}{suffix}" for c in table.columns for suffix in ("_thesis", "_measured")]
    seeded = [c for c in table.columns if any(c.key in row.over_seeds for row in table.rows)]
    further = [f"{c.key}{suffix}" for c in seeded for suffix in ("_seeds_mean", "_seeds_low", "_seeds_high")]
    writer.writerow(["row", *head, "samples", *further])
    for row in table.rows:
        over_seeds = [format_cell(value, c.decimals) for c in seeded for value in _over_seeds(row, c.key)]
        samples = row.samples if row.samples is not None else ""
        writer.writerow([row.key, *_cells(table, row), samples, *over_seeds])
    return stream.getvalue()


def _over_seeds(row: Row, column: str) -> tuple[Cell, Cell, Cell]:
    found = row.over_seeds.get(column)
    return (None, None, None) if found is None else (found.cell[0], *found.interval)


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
