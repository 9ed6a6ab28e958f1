"""Headline results: the thesis's beside those measured here, with 95 % intervals, and which of them is better."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from pipeline.report.intervals import Interval, difference_of_means, difference_of_shares, mean_interval, share_interval
from pipeline.report.tables import Column, ReportTable
from pipeline.tables import Cell, format_cell, mean_of

_SPECS = Path(__file__).with_name("headlines.yaml")
BETTER, EQUAL, WORSE, OPEN, UNLIKE = "better", "equal", "worse", "open", "unlike"


@dataclass(frozen=True)
class HeadlineSpec:
    """A headline as ``headlines.yaml`` holds it."""

    label: str
    table: str
    row: str
    column: str
    share: bool = False
    samples: int | None = None  # behind the thesis's cell
    over: str = ""
    level: float | None = None
    measured: tuple[str, str, str] | None = None  # table, row, column; None: the thesis's own cell
    comparable: bool = False  # whether the same thing was measured
    differs: str = ""


@dataclass(frozen=True)
class Headline:
    """A line of the first table."""

    label: str  # what was measured, in words
    chapter: str  # of the thesis
    table: str  # key of the table that has the cell
    thesis: str  # thesis and here: both values in words, with their unit; `here` is empty where nothing was measured
    here: str
    interval: str  # 95 % interval of the measured value in words; empty where its samples are unknown or fewer than two
    samples: int | None  # behind the measured value
    differs: str  # from the thesis, in words
    # "better", "equal", "worse", "open" for a single sample, "unlike" where another thing was measured; or ""
    verdict: str
    # how many of them the run had, where the value, its interval and the verdict are over seeds; otherwise 0
    seeds: int = 0


@functools.cache
def headline_specs() -> tuple[HeadlineSpec, ...]:
    """The headlines of ``headlines.yaml``, in the thesis's order."""
    return tuple(HeadlineSpec(**entry) for entry in yaml.safe_load(_SPECS.read_text(encoding="utf-8")))


def headlines(tables: Sequence[ReportTable]) -> list[Headline]:
    """Compares every headline, whose tables, rows and columns must be there."""
    by_key = {table.key: table for table in tables}
    return [_headline(spec, by_key) for spec in headline_specs()]


def _headline(spec: HeadlineSpec, tables: Mapping[str, ReportTable]) -> Headline:
    table = tables[spec.table]
    rows = {row.key: row for row in table.rows}
    row, column = rows[spec.row], next(column for column in table.columns if column.key == spec.column)
    thesis, value, unit, measured = row.thesis[column.key], row.measured.get(column.key), column.unit, column.key
    if spec.measured is not None:
        key, name, measured = spec.measured
        matches = [other for other in tables[key].rows if other.key == name] if key in tables else []
        row, value = (matches[0], matches[0].measured.get(measured)) if matches else (row, None)
    if spec.over:
        base = rows[spec.over]
        thesis, value = _share_of(thesis, base.thesis[column.key]), _share_of(value, base.measured.get(column.key))
        column, unit = Column(column.key, column.label, "%", column.better, 1), "%"
    if not isinstance(value, int | float | list):
        words = _words(thesis, column, unit)
        return Headline(spec.label, table.chapter, table.key, words, "", "", None, spec.differs, "")
    if spec.share:
        thesis, value = mean_of(thesis), mean_of(value)
    samples = None if spec.over else row.samples
    seeded, share = None if spec.over else row.over_seeds.get(measured), spec.share
    if seeded is not None:
        value, samples, share = seeded.cell, seeded.seeds, False
    interval = share_interval(mean_of(value), samples) if share else mean_interval(value, samples)
    if seeded is not None:
        interval = seeded.interval
    return Headline(
        label=spec.label, chapter=table.chapter, table=table.key, thesis=_words(thesis, column, unit),
        here=_words(value, column, unit), interval=_interval_words(interval, column, unit), samples=samples,
        differs=spec.differs, verdict=UNLIKE if not spec.comparable else compare(
            thesis, value, thesis_samples=spec.samples, samples=samples, share=share, level=spec.level,
            higher_is_better=column.better != "lower", decimals=column.decimals,
        ),
        seeds=0 if seeded is None else seeded.seeds,
    )  # fmt: skip


def compare(
    thesis: Cell, here: Cell, *, thesis_samples: int | None, samples: int | None, share: bool = False,
    level: float | None = None, higher_is_better: bool = True, decimals: int | None = None,
) -> str:  # fmt: skip
    """Says whether a measured value is better than the thesis's, equal to it, or worse; "open" for a single sample.

    Where the measured value has an interval, it is "equal" when the 95 % interval of the difference holds zero:
    Newcombe's for shares, Welch's for means. A thesis's value with unknown samples is taken as exact. Single numbers
    are equal when they print alike; p values are equal on the same side of their level.

    Args:
        thesis, here: number, or mean and standard deviation; shares in percent.
        thesis_samples, samples: behind either; None where unknown.

    Source: Newcombe 1998, "Interval estimation for the difference between independent proportions", method 10.
    """
    if samples == 1:
        return OPEN
    sign = 1.0 if higher_is_better else -1.0
    difference = mean_of(here) - mean_of(thesis)
    if level is not None:
        sides = (mean_of(here) >= level) - (mean_of(thesis) >= level)
        return EQUAL if not sides else BETTER if sides > 0 else WORSE
    if share and samples:
        low, high = difference_of_shares(mean_of(here), samples, mean_of(thesis), thesis_samples)
    elif isinstance(here, list) and samples:
        low, high = difference_of_means(here, samples, thesis, thesis_samples)
    else:
        same = format_cell(mean_of(here), decimals) == format_cell(mean_of(thesis), decimals)
        low = high = 0.0 if same else difference
    if low <= 0.0 <= high:
        return EQUAL
    return BETTER if sign * difference > 0 else WORSE


def _share_of(cell: Cell, base: Cell) -> float | None:
    if not isinstance(cell, int | float) or not isinstance(base, int | float) or not base:
        return None
    return 100.0 * cell / base


def _words(cell: Cell, column: Column, unit: str) -> str:
    return " ".join(filter(None, (format_cell(cell, column.decimals), unit)))


def _interval_words(interval: Interval | None, column: Column, unit: str) -> str:
    if interval is None:
        return ""
    low, high = (format_cell(bound, column.decimals) for bound in interval)
    return " ".join(filter(None, (f"{low} to {high}", unit)))
