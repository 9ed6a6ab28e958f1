"""Marks of finished items: what an interrupted stage need not do again while the files are still as they were left.

``.progress/`` in a stage's folder holds, for each item,

- ``item-<key>.json``, the mark: the item's result, and size and SHA-256 of every file that it wrote;
- ``files-<key>.txt``, what it has written so far, a line a file, until it is marked;

and ``identity.json``, what the results depend on. Without that file no mark counts: removing it is the first step of
clearing a folder, so that a kill in the middle leaves nothing that somebody could trust.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import shutil
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.file_memory import CACHE, FileMemory
from pipeline.store.provenance import hash_value
from pipeline.store.written_files import noted, read_journal

PROGRESS = ".progress"
_LONGEST_NAME = 80

_LOGGER = logging.getLogger(__name__)


class Marks:
    """The marks of one stage's folder."""

    def __init__(self, folder: Path, memory: FileMemory) -> None:
        self._folder, self._memory = folder, memory
        self._place = folder / PROGRESS
        self._identity = self._place / "identity.json"
        self._results: dict[str, Any] = {}

    def belong_to(self, fingerprint: str) -> bool:
        """Tells whether the marks are of results of this identity."""
        try:
            return bool(read_json(self._identity) == fingerprint)
        except (OSError, ValueError):
            return False

    def revoke(self) -> None:
        """Makes every mark count no more, in one step."""
        self._identity.unlink(missing_ok=True)
        self._results.clear()

    def begin(self, fingerprint: str) -> None:
        """Opens the marks of results of an identity; the folder must be clear."""
        write_json(self._identity, fingerprint)

    def remove(self) -> None:
        """Removes all marks."""
        self.revoke()
        shutil.rmtree(self._place, ignore_errors=True)

    def verify(self) -> int:
        """Makes marks of items whose files are not as they were left count no more, and removes what is left of those.

        Files that no other item wrote go, too: the stage made them from the items.

        Returns:
            How many items count.
        """
        marks = {path: self._read(path) for path in sorted(self._place.glob("item-*.json"))}
        broken = []
        for path, mark in marks.items():
            wrong = "its mark" if mark is None else self._first_wrong(mark["files"])
            if wrong is not None:
                _LOGGER.warning(
                    "%s: %s is missing or was changed, so it is done again", mark["key"] if mark else path.stem, wrong
                )
                broken.append(path)
        if broken:
            kept = {name for path, mark in marks.items() if mark and path not in broken for name in mark["files"]}
            kept |= {name for path in self._place.glob("files-*.txt") for name in read_journal(path)}
            kept -= {name for path in broken for name in self._written(path)}
            remove_files(self._folder, keep=kept)
            for path in broken:
                self._remove_item(path)
        return len(marks) - len(broken)

    def forget(self, key: str) -> None:
        """Makes an item's mark count no more, and removes its files: something it was made from is made again."""
        self._remove_item(self._mark(key))
        self._results.pop(key, None)

    @contextlib.contextmanager
    def noted(self, key: str) -> Iterator[None]:
        """Notes what this process writes for an item."""
        with noted(self._folder, self.journal(key)):
            yield

    def journal(self, key: str) -> Path:
        """Where an item's files are noted."""
        return self._place / f"files-{_safe(key)}.txt"

    def mark(self, key: str, result: Any) -> None:
        """Marks an item as done.

        Args:
            result: JSON value that the stage wants back.
        """
        files = {}
        for name in read_journal(self.journal(key)):
            file = self._folder / name
            if file.is_file() and not name.startswith((f"{PROGRESS}/", f"{CACHE}/")):
                files[name] = {"sha256": self._memory.digest(file), "bytes": file.stat().st_size}
        write_json(self._mark(key), {"key": key, "result": result, "files": files})
        self.journal(key).unlink(missing_ok=True)
        self._results[key] = result

    def result(self, key: str) -> Any | None:
        """What a marked item left; None while it is not marked."""
        if key not in self._results:
            mark = self._read(self._mark(key))
            if mark is not None:
                self._results[key] = mark["result"]
        return self._results.get(key)

    def _mark(self, key: str) -> Path:
        return self._place / f"item-{_safe(key)}.json"

    def _read(self, path: Path) -> dict[str, Any] | None:
        try:
            mark = read_json(path)
            files = {
                str(name): {"sha256": str(e["sha256"]), "bytes": int(e["bytes"])} for name, e in mark["files"].items()
            }
            return {"key": str(mark["key"]), "result": mark["result"], "files": files}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def _first_wrong(self, files: dict[str, Any]) -> str | None:
        wrong = (n for n, e in files.items() if not self._memory.holds(self._folder / n, e["sha256"], e["bytes"]))
        return next(wrong, None)

    def _written(self, path: Path) -> set[str]:
        """What an item wrote, by its mark and by notes of a later attempt."""
        mark = self._read(path)
        return {*(mark["files"] if mark else ()), *read_journal(self._notes_beside(path))}

    def _notes_beside(self, path: Path) -> Path:
        return path.with_name(f"files-{path.stem.removeprefix('item-')}.txt")

    def _remove_item(self, path: Path) -> None:
        for name in self._written(path):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                (self._folder / name).unlink()
        self._notes_beside(path).unlink(missing_ok=True)
        path.unlink(missing_ok=True)  # last: without its files it does not count anyway


def remove_files(folder: Path, *, keep: Set[str] = frozenset()) -> None:
    """Removes files of a stage's folder, and folders that are empty then; what begins with a dot stays.

    Args:
        keep: names relative to it that stay.
    """
    for place, _, files in os.walk(folder, topdown=False):
        inside = Path(place).relative_to(folder)
        if any(part.startswith(".") for part in inside.parts):
            continue
        for name in files:
            if not name.startswith(".") and (inside / name).as_posix() not in keep:
                (Path(place) / name).unlink()
        if inside.parts and not any(Path(place).iterdir()):
            Path(place).rmdir()


def _safe(key: str) -> str:
    readable = re.sub(r"[^A-Za-z0-9_.-]", "_", key)[:_LONGEST_NAME]
    return f"{readable}-{hash_value(key)[:10]}"
