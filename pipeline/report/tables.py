"""Tables of the report: the thesis's cells, as `thesis.yaml` holds them, beside the measured ones; CSV and LaTeX."""

from __future__ import annotations

import csv
import functools
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import yaml

from pipeline.plots.words import column_words, group_words, plain, row_words
from pipeline.report.intervals import CellName, OverSeeds
from pipeline.tables import SAMPLES, Cell, Table, format_cell, pool

_THESIS = Path(__file__).with_name("thesis.yaml")
KINDS = ("results", "settings", "literature", "own")
NOT_RUN = "not run"
OVER_SEEDS = "over_seeds"
_LONGEST_CELL = 60  # characters; longer texts stand beneath a table


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str
    label: str
    unit: str = ""
    better: str = ""  # "higher", "lower", or "" where neither is better
    decimals: int | None = None  # as the thesis prints it; None: as many as the value needs


@dataclass(frozen=True)
class Row:
    """A row of a table: the thesis's cells, and the measured ones once a stage has run."""

    key: str
    label: str
    group: str  # "" in a table without groups
    thesis: dict[str, Cell]
    measured: dict[str, Cell]
    samples: int | None = None  # behind the measured pairs
    in_thesis: bool = True
    over_seeds: dict[str, OverSeeds] = field(default_factory=dict)  # column -> the figure over run seeds


@dataclass(frozen=True)
class ReportTable:
    """One table of the report."""

    key: str
    title: str
    chapter: str
    label: str
    kind: str
    stage: str  # which stage measures it; "" for literature
    note: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]

    def has_words(self, column: Column) -> bool:
        """Whether any shown cell of a column, thesis or measured, is text, which reads better from the left."""
        cells = [side.get(column.key) for row in self.shown_rows for side in (row.thesis, row.measured)]
        return any(isinstance(cell, str) and len(cell) <= _LONGEST_CELL for cell in cells)

    @property
    def cells(self) -> int:
        """How many cells of the thesis could be measured; of an own table, how many are shown."""
        if self.kind == "literature":
            return 0
        return sum(row.thesis.get(c.key) is not None or not row.in_thesis for row in self.rows for c in self.columns)

    @property
    def measured_cells(self) -> int:
        return sum(row.measured.get(c.key) is not None for row in self.rows for c in self.columns)

    @property
    def sentences(self) -> list[tuple[str, str]]:
        """What was measured in so many words that it stands beneath the table: rows' labels and texts."""
        cells = [(row.label, row.measured.get(c.key)) for row in self.rows for c in self.columns]
        return [(label, cell) for label, cell in cells if isinstance(cell, str) and len(cell) > _LONGEST_CELL]

    @property
    def shown_rows(self) -> list[Row]:
        """Its rows without those that stand beneath it."""
        beneath = {label for label, _ in self.sentences}
        return [row for row in self.rows if row.label not in beneath or row.in_thesis]

    @property
    def has_run(self) -> bool:
        return self.measured_cells > 0


@dataclass(frozen=True)
class _Spec:
    """A table as ``thesis.yaml`` holds it."""

    title: str
    chapter: str
    label: str
    columns: dict[str, dict[str, Any]]
    rows: dict[str, list[Cell]]
    kind: str = "results"
    stage: str = ""
    note: str = ""
    labels: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks that no row has more cells than there are columns."""
        if self.kind not in KINDS:
            raise ValueError(f"table {self.title!r}: kind {self.kind!r} is none of {', '.join(KINDS)}")
        for key, cells in self.rows.items():
            if len(cells) > len(self.columns):  # later columns are this project's own
                raise ValueError(
                    f"table {self.title!r}, row {key!r}: {len(cells)} cells for {len(self.columns)} columns"
                )


@functools.cache
def _thesis() -> tuple[dict[str, _Spec], dict[str, str]]:
    content = yaml.safe_load(_THESIS.read_text(encoding="utf-8"))
    return {key: _Spec(**table) for key, table in content["tables"].items()}, content["groups"]


def group_labels() -> dict[str, str]:
    """Names of groups of rows, such as phantoms and targets, in words."""
    return _thesis()[1]


def row_labels(table: str) -> dict[str, str]:
    """Names of a table's rows, without their groups, in words; rows that need none are absent."""
    specs = _thesis()[0]
    return specs[table].labels if table in specs else {}


def join_sweep(parts: Iterable[dict[str, Table]], variants: Sequence[str] = ()) -> dict[str, Table]:
    """Joins what folders measured: different cells side by side, equal ones pooled; sample counts become ``n``.

    Args:
        variants: what each part's settings differ in, seeds left out; where parts of several have the same cell, each
            has a row of its own, with its variant in brackets, unless the cell is a setting that they share.
    """
    collected: dict[tuple[str, str], dict[str, dict[str, list[tuple[Cell, int | None]]]]] = {}
    for results, variant in zip(parts, chain(variants, repeat("")), strict=False):
        for table, rows in results.items():
            for row, columns in rows.items():
                samples = columns.get(SAMPLES)
                count = int(samples) if isinstance(samples, int | float) else None
                for column, cell in columns.items():
                    if column != SAMPLES:
                        of_variants = collected.setdefault((table, row), {}).setdefault(column, {})
                        of_variants.setdefault(variant, []).append((cell, count))
    joined: dict[str, Table] = {}
    for (table, row), of_columns in collected.items():
        differ = any(_differ(of_variants.values()) for of_variants in of_columns.values())
        exact: set[str] = set()  # rows whose number of samples is known
        for column, of_variants in of_columns.items():
            for variant, cells in of_variants.items():
                name = f"{row} ({variant.replace('/', '·')})" if differ and variant else row
                target = joined.setdefault(table, {}).setdefault(name, {})
                target[column], samples_of = pool(cells)
                of_samples = all(count for _, count in cells)
                if samples_of is not None and (of_samples or name not in exact):
                    target[SAMPLES] = samples_of
                    exact |= {name} if of_samples else set()
    return joined


def _differ(cells: Collection[list[tuple[Cell, int | None]]]) -> bool:
    """Whether a cell of several variants is measured, or a setting that they do not share."""
    known = [one for of_variant in cells for one in of_variant]
    return len(cells) > 1 and (any(count for _, count in known) or len({repr(cell) for cell, _ in known}) > 1)


def report_tables(
    measured: dict[str, Table], over_seeds: Mapping[CellName, OverSeeds] | None = None
) -> list[ReportTable]:
    """The thesis's tables with measured cells, and those over seeds, beside its own; then all other tables."""
    specs, groups = _thesis()
    seeded: dict[str, dict[tuple[str, str], OverSeeds]] = {}
    for (table, row, column), figure in (over_seeds or {}).items():
        seeded.setdefault(table, {})[row, column] = figure
    tables = [_merge(key, spec, groups, measured.get(key, {}), seeded.get(key, {})) for key, spec in specs.items()]
    for key, rows in measured.items():
        if key not in specs:
            columns = {c: _further(c) for cells in rows.values() for c in cells if c != SAMPLES}
            spec = _Spec(title=plain(key), chapter="Beyond the thesis", label="not in the thesis",
                         kind="own", columns=columns, rows={})  # fmt: skip
            tables.append(_merge(key, spec, groups, rows, seeded.get(key, {})))
    return [table for table in tables if table.kind != "own" or table.rows]


def _merge(
    key: str, spec: _Spec, groups: dict[str, str], measured: Table, seeded: Mapping[tuple[str, str], OverSeeds]
) -> ReportTable:
    columns = [Column(key=name, **column) for name, column in spec.columns.items()]
    known = set(spec.columns)
    further = dict.fromkeys(c for cells in measured.values() for c in cells if c not in known and c != SAMPLES)
    columns += [Column(key=name, **_further(name)) for name in further]
    rows = []
    for name in [*spec.rows, *(row for row in measured if row not in spec.rows)]:
        group, _, short = name.rpartition("/")
        cells = measured.get(name, {})
        samples = cells.get(SAMPLES)
        rows.append(Row(
            key=name, label=row_words(short, {**groups, **spec.labels}), group=group_words(group, groups, spec.labels),
            thesis=dict(zip(spec.columns, spec.rows.get(name, []), strict=False)),
            measured={c.key: cells.get(c.key) for c in columns},
            samples=int(samples) if isinstance(samples, int | float) else None, in_thesis=name in spec.rows,
            over_seeds={c.key: seeded[name, c.key] for c in columns if (name, c.key) in seeded},
        ))  # fmt: skip
    order = list(dict.fromkeys(row.group for row in rows))
    rows.sort(key=lambda row: order.index(row.group))  # own rows join their group
    return ReportTable(key=key, title=spec.title, chapter=spec.chapter, label=spec.label, kind=spec.kind,
                       stage=spec.stage, note=spec.note, columns=tuple(columns), rows=tuple(rows))  # fmt: skip


def _further(key: str) -> dict[str, Any]:
    label, unit = column_words(key)
    return {"label": label, "unit": unit}


def metrics(tables: list[ReportTable]) -> dict[str, dict[str, dict[str, Any]]]:
    """Lists every measured cell for programs, None where it has not run; a row's `over_seeds` has those figures."""
    return {table.key: {row.key: _values(row) for row in table.rows} for table in tables}


def _values(row: Row) -> dict[str, Any]:
    values: dict[str, Any] = dict(row.measured)
    if row.samples is not None:
        values[SAMPLES] = row.samples
    if row.over_seeds:
        values[OVER_SEEDS] = {
            column: {"mean": one.cell[0], "interval": list(one.interval), "seeds": one.seeds}
            for column, one in row.over_seeds.items()
        }
    return values


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
    figure = row.over_seeds.get(column)
    return (None, None, None) if figure is None else (figure.cell[0], *figure.interval)


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
