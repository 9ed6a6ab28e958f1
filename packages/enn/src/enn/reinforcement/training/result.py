"""What a training reports: its progress, its curve with the file that it is kept in, and its result."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from enn.policy import Policy

COLUMNS = (
    "decisions",
    "env_steps",
    "wall_s",
    "cpu_s",
    "reward",
    "episode_length",
    "success",
    "evaluation_success",
    "evaluation_stochastic_success",
    "evaluation_length",
    "evaluation_path_mm",
    "evaluation_force",
)
Row = dict[str, Any]


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    decisions: int  # taken so far
    total: int
    # share of the latest training episodes from the usual start that succeeded; None before the first
    success: float | None
    episode_return: float | None  # mean sum of rewards of the latest training episodes; None before the first
    best_success: float | None  # of the policy kept so far, in its evaluation; None before the first one
    wall_s: float  # since the training began, all its runs together
    remaining_s: float  # estimate to the end of the budget


@dataclass(frozen=True)
class TrainingResult:
    """What a training gives."""

    policy: Policy  # the best by evaluation (or the last, when there were none)
    curve: list[dict[str, Any]]
    timings: dict[str, float]  # seconds in all and in parts, and what was done in them
    # of the best policy: success, stochastic_success, steps, path_mm, force_mean, force_max, decisions
    evaluation: dict[str, float] | None


def write_curve(path: Path, curve: list[Row]) -> None:
    """Writes rows, what was not measured as an empty cell; atomically."""
    lines = [",".join(COLUMNS)]
    lines += [",".join("" if row[name] is None else str(row[name]) for name in COLUMNS) for row in curve]
    replace_text(path, "\n".join(lines) + "\n")


def read_curve(path: Path) -> list[Row]:
    """Reads what `write_curve` wrote."""
    with path.open(newline="", encoding="utf-8") as stream:
        return [{name: _number(value) for name, value in row.items()} for row in csv.DictReader(stream)]


def replace_text(path: Path, text: str) -> None:
    """Writes a small file at once: a reader sees the former text or this one."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.unlink(missing_ok=True)  # a link of that name would be written through
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


def _number(text: str) -> float | int | None:
    if text == "":
        return None
    return float(text) if any(letter in text for letter in ".en") else int(text)
