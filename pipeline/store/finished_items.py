"""Finished items: what an interrupted stage need not do again while the files are still as they were left.

``.progress/`` in a stage's folder holds, for each item,

- ``item-<key>.json``, once it is finished: its result, and size and SHA-256 of every file that it wrote;
- ``files-<key>.txt``, what it has written so far, a line a file, until then;

and ``identity.json``, what the results depend on. Without that file no item counts: removing it is the first step of
clearing a folder, so that a kill in the middle leaves nothing that somebody could trust.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Set
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.file_cache import CACHE, FileCache, digests_of
from pipeline.store.manifest import Files
from pipeline.store.provenance import hash_value
from pipeline.store.written_files import noted, read_journal

PROGRESS = ".progress"
_LONGEST_NAME = 80

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Item:
    """The record of a finished item."""

    key: str
    result: Any
    files: Files


_ITEMS = TypeAdapter(_Item)


class FinishedItems:
    """The items of one stage's folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._digests: FileCache = digests_of(path)
        self._place = path / PROGRESS
        self._identity_path = self._place / "identity.json"
        self._results: dict[str, Any] = {}

    def result_of(self, key: str) -> Any | None:
        """What was given to ``mark_done`` of a finished item ({} when nothing was), or None while it is not done."""
        if key not in self._results and (item := _read(self._record(key))) is not None:
            self._results[key] = item.result
        return self._results.get(key)

    def noted(self, key: str) -> contextlib.AbstractContextManager[None]:
        """Notes the files that this process writes while the body runs as an item's."""
        return noted(self.path, self.journal(key))

    def journal(self, key: str) -> Path:
        """Where another process that works on an item notes its files: see `pipeline.store.atomic_files.noted`."""
        return self._place / f"files-{safe_name(key)}.txt"

    def mark_done(self, key: str, result: Any = None) -> None:
        """Keeps that an item is finished, the files noted for it, which are written, and JSON for the summary."""
        files = {}
        for name in read_journal(self.journal(key)):
            if (self.path / name).is_file() and not name.startswith((f"{PROGRESS}/", f"{CACHE}/")):
                files[name] = self._digests.entry(self.path / name)
        item = _Item(key, {} if result is None else result, files)
        write_json(self._record(key), asdict(item))
        self.journal(key).unlink(missing_ok=True)
        self._results[key] = item.result

    def forget(self, key: str) -> None:
        """Has an item done again from nothing, as after what it was made from; its files are removed."""
        self._remove(self._record(key))
        self._results.pop(key, None)

    def _belong_to(self, fingerprint: str) -> bool:
        """Tells whether the items are of results of this identity."""
        try:
            return bool(read_json(self._identity_path) == fingerprint)
        except (OSError, ValueError):
            return False

    def _revoke(self) -> None:
        """Makes every item count no more, in one step."""
        self._identity_path.unlink(missing_ok=True)
        self._results.clear()

    def _verify(self) -> int:
        """Removes items whose files are not as they were left, and files that no other item wrote."""
        items = {path: _read(path) for path in sorted(self._place.glob("item-*.json"))}
        broken = []
        for path, item in items.items():
            wrong = "its record" if item is None else self._digests.first_changed(self.path, item.files)
            if wrong is not None:
                name = path.stem if item is None else item.key
                _LOGGER.warning("%s: %s is missing or was changed, so it is done again", name, wrong)
                broken.append(path)
        if broken:
            file_names = {name for path, item in items.items() if item and path not in broken for name in item.files}
            file_names |= {name for path in self._place.glob("files-*.txt") for name in read_journal(path)}
            file_names -= {name for path in broken for name in _written(path)}
            _remove_files(self.path, keep=file_names)
            for path in broken:
                self._remove(path)
        return len(items) - len(broken)

    def _record(self, key: str) -> Path:
        return self._place / f"item-{safe_name(key)}.json"

    def _remove(self, record: Path) -> None:
        for name in _written(record):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                (self.path / name).unlink()
        _journal_beside(record).unlink(missing_ok=True)
        record.unlink(missing_ok=True)  # last: without its files it does not count anyway


def _read(record: Path) -> _Item | None:
    try:
        return _ITEMS.validate_python(read_json(record))
    except (OSError, ValueError, AttributeError):
        return None


def _written(record: Path) -> set[str]:
    """What an item wrote, by its record and by notes of a later attempt."""
    item = _read(record)
    return {*(item.files if item else ()), *read_journal(_journal_beside(record))}


def _journal_beside(record: Path) -> Path:
    return record.with_name(f"files-{record.stem.removeprefix('item-')}.txt")


def _remove_files(folder: Path, *, keep: Set[str]) -> None:
    """Removes files of a stage's folder but those to keep, and empty folders; what begins with a dot stays."""
    for place, _, files in os.walk(folder, topdown=False):
        inside = Path(place).relative_to(folder)
        if any(part.startswith(".") for part in inside.parts):
            continue
        for name in files:
            if not name.startswith(".") and (inside / name).as_posix() not in keep:
                (Path(place) / name).unlink()
        if inside.parts and not any(Path(place).iterdir()):
            Path(place).rmdir()


def safe_name(key: str) -> str:
    """The name of an item as a part of a file's name; no two items share one."""
    readable = re.sub(r"[^A-Za-z0-9_.-]", "_", key)[:_LONGEST_NAME]
    return f"{readable}-{hash_value(key)[:10]}"
