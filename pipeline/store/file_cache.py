"""What is known of files: remembered by size, times and inode, so that an unchanged file is not read again."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import open_file, write_text
from pipeline.store.provenance import hash_file

CACHE = ".cache"  # below the run's folder; it may be deleted
# A file system's clock ticks every few milliseconds: a file that was just written may change again within a tick.
_SETTLED_NS = 100_000_000


class FileCache:
    """Values computed from files, kept in a small file between processes: a line with a checksum, a line of JSON.

    A value counts while size, modification time, status change time and inode of its file stay. Several processes may
    keep the same cache: the last one to save wins, and what it lacks is computed again.
    """

    def __init__(self, store: Path | None, root: Path, *, version: str = "1") -> None:
        """Values of one version; without a store nothing is kept, and one that cannot be read is empty."""
        self._store, self._root, self._version = store, root, version
        self._known: dict[str, Any] = {}  # name -> [stamp, value]
        self._changed = False
        if store is not None:
            try:
                with open_file(store) as file:
                    check, _, text = file.read().decode("utf-8").partition("\n")
                if check == _check(text, version):
                    self._known = json.loads(text)
            except (OSError, ValueError):
                pass

    def recall(self, file: Path) -> Any | None:
        """The value that is known of a file; None where there is none, or the file has changed since."""
        entry = self._known.get(self._name(file))
        return entry[1] if entry is not None and entry[0] == _stamp(file.stat()) else None

    def compute(self, file: Path, function: Callable[[Path], Any]) -> Any:
        """Computes the value of a file, any of JSON, and remembers it."""
        before = file.stat()
        value = function(file)
        stamp = _stamp(before)
        settled = time.time_ns() - max(before.st_mtime_ns, before.st_ctime_ns) > _SETTLED_NS
        name = self._name(file)
        if settled and stamp == _stamp(file.stat()):
            self._known[name], self._changed = [stamp, value], True
        elif self._known.pop(name, None) is not None:
            self._changed = True
        return value

    def digest(self, file: Path) -> str:
        """SHA-256 of a file, in hex."""
        known = self.recall(file)
        return str(known if known is not None else self.compute(file, hash_file))

    def entry(self, file: Path) -> dict[str, Any]:
        """What a manifest keeps of a file: SHA-256 in hex, and size in bytes."""
        return {"sha256": self.digest(file), "bytes": file.stat().st_size}

    def first_changed(self, folder: Path, files: Mapping[str, Mapping[str, Any]]) -> str | None:
        """The first of some files below a folder that is missing or not as its entry says; None when all are right."""
        changed = (n for n, entry in files.items() if not self.holds(folder / n, entry["sha256"], entry["bytes"]))
        return next(changed, None)

    def holds(self, file: Path, sha256: str, size: int) -> bool:
        """Tells whether a file is there with a content of this digest, in hex, and size in bytes."""
        try:
            status = file.stat()
            return status.st_size == size and stat.S_ISREG(status.st_mode) and self.digest(file) == sha256
        except (FileNotFoundError, NotADirectoryError):
            return False

    def save(self) -> None:
        """Writes what is known; files that are gone are forgotten."""
        if self._store is None or not self._changed:
            return
        files = {name: entry for name, entry in self._known.items() if (self._root / name).exists()}
        text = json.dumps(files)
        write_text(self._store, f"{_check(text, self._version)}\n{text}")
        self._changed = False

    def _name(self, file: Path) -> str:
        return os.path.relpath(file, self._root)


def digests_of(folder: Path) -> FileCache:
    """The cache of a stage folder's digests."""
    return FileCache(folder.parent / CACHE / "digests" / f"{folder.name}.json", folder)


def _check(text: str, version: str) -> str:
    return hashlib.sha256(f"{version}\n{text}".encode()).hexdigest()


def _stamp(status: os.stat_result) -> list[int]:
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]
