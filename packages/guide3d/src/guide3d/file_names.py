"""Names of files in a folder: capitals or not, numbers in their order, and without a system's hidden files."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path


def files_in(folder: Path, *patterns: str) -> list[Path]:
    """Files of a folder whose names match a pattern, whatever their capitals, in `numeric_order`.

    Args:
        folder: that there need not be.
        patterns: as the shell has them, such as "*.txt".
    """
    if not folder.is_dir():
        return []
    wanted = [pattern.lower() for pattern in patterns]
    files = (file for file in folder.iterdir() if not file.name.startswith("."))
    return numeric_order(file for file in files if any(fnmatchcase(file.name.lower(), one) for one in wanted))


def numeric_order(files: Iterable[Path]) -> list[Path]:
    """Sorts files by name, numbers in it by their value: 2.png before 10.png."""
    return sorted(files, key=lambda file: ([_part(part) for part in re.split(r"(\d+)", file.name.lower())], file.name))


def _part(text: str) -> tuple[int, str]:
    return (int(text), "") if text.isdecimal() and len(text) < 4000 else (-1, text)
