"""Atomic writing: a file is either the old one or the new one, whole, whatever happens in between."""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

TEMPORARY_PREFIX = ".writing-"


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Lends a temporary path beside ``path`` and moves it there once the body has written it.

    The temporary name keeps the suffix, because writers such as ``numpy.savez`` and mesh exporters choose their format
    by it. When the body raises, also through Ctrl-C, the temporary file is removed and ``path`` stays as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    temporary.unlink(missing_ok=True)  # a link of that name would be written through
    try:
        yield temporary
        _flush_to_disk(temporary)
        os.replace(temporary, path)
        _flush_to_disk(path.parent)
    finally:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Writes a text file atomically in UTF-8."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Writes a JSON file atomically, indented, keys in the order given; a ValueError for NaN and infinity."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes arrays into one ``.npz`` file atomically, uncompressed."""
    import numpy as np

    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def open_file(path: Path) -> BufferedReader:
    """Opens a file of a run's folder; a ValueError where it is none, such as a pipe, which would be waited for."""
    if not stat.S_ISREG(mode := path.stat().st_mode) and not stat.S_ISDIR(mode):  # a folder is an OSError
        raise ValueError(f"{path} is no regular file")
    return path.open("rb")


def read_json(path: Path) -> Any:
    """Reads a JSON file; a ValueError where it is none, or nested deeper than anything that is written here."""
    try:
        with open_file(path) as file:
            return json.loads(file.read().decode("utf-8"))
    except RecursionError as error:
        raise ValueError(f"{path} is nested too deeply") from error


def remove_unfinished(folder: Path) -> None:
    """Removes what a killed writer left in a folder and below it; call it only while holding the folder's lock."""
    for path in list(folder.rglob(f"{TEMPORARY_PREFIX}*")):
        if path.is_symlink() or not path.is_dir():
            path.unlink(missing_ok=True)


def _flush_to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
