"""Text and JSON files as programs of any country write them: byte order marks, separators and decimal commas."""

from __future__ import annotations

import argparse
import codecs
import csv
import json
import re
from pathlib import Path
from typing import Any

from guide3d.guarded_reading import open_regular

_LARGEST = 64 << 20  # bytes; the longest annotations have a tenth of it
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_DECIMAL = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?")


def read_text(path: Path, what: str) -> str:
    """Reads UTF-8, or UTF-16 that begins with its mark; a mark at the start is left out.

    Args:
        what: it is, for messages: "camera file".

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no regular file, too large, or holds no text.
    """
    if not path.exists():
        raise FileNotFoundError(f"{what} {path} is missing")
    with open_regular(path, _LARGEST) as file:
        data = file.read()
    try:
        return data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: expected a text file, a {what}, found binary data") from None


def cells_of(line: str) -> list[str]:
    """What stands between the separators of a line, numbers with a decimal point; empty cells at the end are left out.

    Separators are semicolons, else tabs, else commas, else spaces. A comma within a cell is a decimal one, and so are
    those of numbers with spaces between them: "1,5 2,5".
    """
    separator = next((mark for mark in ";\t," if mark in line), " ")
    words = line.split()
    if separator == " " or (separator == "," and len(words) > 1 and all(map(_DECIMAL.fullmatch, words))):
        cells = words
    else:
        try:
            cells = next(csv.reader([line.strip("\r\n")], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:
            cells = [line]
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return [cell.replace(",", ".") if _DECIMAL.fullmatch(cell) else cell for cell in cells]


def numbers_in(line: str) -> list[float] | None:
    """The numbers of a line, as `cells_of` divides it; None where a cell is no number."""
    try:
        return [float("_" if "_" in cell else cell) for cell in cells_of(line)]
    except ValueError:
        return None


def read_json(path: Path, what: str) -> Any:
    """Reads a file; `what` it is, for messages: "annotation file".

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no regular file, no JSON, or nested deeper than any file of a data set.
    """
    text = read_text(path, what)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected JSON, but it cannot be read ({error})") from None


def json_fields(text: str) -> dict[str, Any]:
    """What an option that changes fields of settings gives: a JSON object; argparse refuses anything else."""
    try:
        content = json.loads(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"expected a JSON object of fields: {error}") from None
    if not isinstance(content, dict):
        raise argparse.ArgumentTypeError(f"expected a JSON object of fields, got {text}")
    return content
