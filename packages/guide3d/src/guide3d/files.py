"""Files: found whatever their capitals, text of any country read, written whole or not at all."""

from __future__ import annotations

import argparse
import codecs
import csv
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO, Any

from guide3d.guarded_reading import open_regular

_LARGEST = 64 << 20  # bytes; the longest annotations have a tenth of it
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_DECIMAL = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?")


def files_in(folder: Path, *patterns: str) -> list[Path]:
    """Files of a folder whose names match a pattern, whatever their capitals, in `numeric_order`.

    Args:
        folder: that there need not be.
        patterns: as the shell has them, such as "*.txt".
    """
    if not folder.is_dir():
        return []
    lower = [pattern.lower() for pattern in patterns]
    files = (file for file in folder.iterdir() if not file.name.startswith("."))
    return numeric_order(file for file in files if any(fnmatchcase(file.name.lower(), one) for one in lower))


def numeric_order(files: Iterable[Path]) -> list[Path]:
    """Sorts files by name, numbers in it by their value: 2.png before 10.png."""
    return sorted(files, key=lambda file: ([_part(part) for part in re.split(r"(\d+)", file.name.lower())], file.name))


def _part(text: str) -> tuple[int, str]:
    return (int(text), "") if text.isdecimal() and len(text) < 4000 else (-1, text)


@contextmanager
def whole_file(path: str | Path, mode: str = "wb") -> Iterator[IO]:
    """Open a new file that takes the place of `path` only when the block ends without an error.

    Args:
        path: Where the file is to appear; its folder is made if missing.
        mode: "wb" or "w" (text is UTF-8, line ends as written).

    Returns:
        A context that gives the open file.

    Raises:
        OSError: The folder cannot be written; nothing is left behind.
    """
    path = Path(path)
    missing = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    text = {} if "b" in mode else {"encoding": "utf-8", "newline": ""}
    try:
        with os.fdopen(handle, mode, **text) as file:  # type: ignore[call-overload]
            yield file
            file.flush()
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)  # mkstemp makes private files
        os.replace(name, path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            for folder in missing:
                folder.rmdir()
        if isinstance(error, OSError) and error.filename is None:  # a full disk names no file
            error.filename = str(path)
        raise


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
