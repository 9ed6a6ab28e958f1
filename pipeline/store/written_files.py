"""What a process writes below a folder, noted as it is opened, so that a finished item knows its files.

The interpreter's audit events tell of every file that Python code opens for writing or renames, whichever library does
it. Files that native code or another program writes under their final name are not seen: `note` names those.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import open_file

_WRITING = os.O_WRONLY | os.O_RDWR
_LONGEST_PART = 255  # bytes that a file system takes
_state: dict[str, _Notes | None] = {"notes": None}
_installed: list[bool] = []


class _Notes:
    """The journal under way."""

    def __init__(self, folder: Path, journal: Path) -> None:
        self._roots = {os.path.abspath(folder) + os.sep, os.path.realpath(folder) + os.sep}
        journal.parent.mkdir(parents=True, exist_ok=True)
        if not journal.is_file():  # a pipe would be waited for
            journal.unlink(missing_ok=True)
        self._descriptor = os.open(journal, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        self._seen: set[str] = set()

    def add(self, path: Any) -> None:
        try:
            text = os.path.abspath(os.fsdecode(path))
        except TypeError:  # a descriptor
            return
        for root in self._roots:
            name = text.removeprefix(root)
            if name != text and name not in self._seen and "\n" not in name:
                self._seen.add(name)
                os.write(self._descriptor, f"{name}\n".encode())  # at once: a killed process keeps its notes

    def close(self) -> None:
        os.close(self._descriptor)


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    notes = _state["notes"]
    if notes is None:
        return
    if event == "open":
        if arguments[2] & _WRITING:
            notes.add(arguments[0])
    elif event == "os.rename":
        notes.add(arguments[1])


@contextlib.contextmanager
def noted(folder: Path, journal: Path) -> Iterator[None]:
    """Notes what this process writes while the body runs: a line a file in the journal, relative to the folder."""
    if not _installed:
        sys.addaudithook(_audit)  # stays for the life of the process
        _installed.append(True)
    former, notes = _state["notes"], _Notes(folder, journal)
    _state["notes"] = notes
    try:
        yield
    finally:
        if _state["notes"] is notes:  # a generator's body may end long after another has begun
            _state["notes"] = former
        notes.close()


def note(*files: Path) -> None:
    """Notes files that another program has written for this process; nothing where nobody asks for notes."""
    if (notes := _state["notes"]) is not None:
        for file in files:
            notes.add(file)


def is_inside(name: str) -> bool:
    """Whether a name, with slashes, is a path below a folder that any file can have."""
    parts = name.split("/")
    return not any(part in ("", ".", "..") or len(os.fsencode(part)) > _LONGEST_PART or "\0" in part for part in parts)


def read_journal(journal: Path) -> list[str]:
    """Paths below its folder in the order in which they were first written; none without a journal."""
    try:
        with open_file(journal) as file:
            lines = file.read().split(b"\n")
    except (FileNotFoundError, ValueError):
        return []
    # What follows the last line's end was cut off by a kill: that file was not opened yet.
    return list(filter(is_inside, dict.fromkeys(map(os.fsdecode, lines[:-1]))))
