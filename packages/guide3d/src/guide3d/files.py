"""Files in a folder: found whatever their capitals, numbers in their order; written whole or not at all."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO


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
