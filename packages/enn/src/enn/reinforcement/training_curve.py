"""Training curve: its columns, and the file that it is kept in."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

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


def write_curve(path: Path, curve: list[Row]) -> None:
    """Writes rows, what was not measured as an empty cell; atomically."""
    lines = [",".join(COLUMNS)]
    lines += [",".join("" if row[name] is None else str(row[name]) for name in COLUMNS) for row in curve]
    replace_text(path, "\n".join(lines) + "\n")


def read_curve(path: Path) -> list[Row]:
    """Reads what `write_curve` wrote."""
    with path.open(newline="") as stream:
        return [{name: _number(value) for name, value in row.items()} for row in csv.DictReader(stream)]


def replace_text(path: Path, text: str) -> None:
    """Writes a small file at once: a reader sees the former text or this one."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text)
    os.replace(temporary, path)


def _number(text: str) -> float | int | None:
    if text == "":
        return None
    return float(text) if any(letter in text for letter in ".en") else int(text)
