"""Finished items: what an interrupted stage need not do again.

``.progress/`` in a stage's folder holds ``item-<key>.json`` for each finished item, its result; and ``identity.json``,
what the results depend on. Without that file no item counts: removing it is the first step of clearing a folder, so
that a kill in the middle leaves nothing that somebody could trust.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.provenance import hash_value

PROGRESS = ".progress"
_LONGEST_NAME = 80


class FinishedItems:
    """The items of one stage's folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._place = path / PROGRESS
        self._identity_path = self._place / "identity.json"
        self._results: dict[str, Any] = {}

    def result_of(self, key: str) -> Any | None:
        """What was given to ``mark_done`` of a finished item ({} when nothing was), or None while it is not done."""
        if key not in self._results and (result := _read(self._record(key))) is not None:
            self._results[key] = result
        return self._results.get(key)

    def mark_done(self, key: str, result: Any = None) -> None:
        """Keeps that an item is finished, whose files are written, and JSON for the summary."""
        result = {} if result is None else result
        write_json(self._record(key), {"key": key, "result": result})
        self._results[key] = result

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

    def _count(self) -> int:
        return sum(_read(path) is not None for path in self._place.glob("item-*.json"))

    def _record(self, key: str) -> Path:
        return self._place / f"item-{safe_name(key)}.json"


def _read(record: Path) -> Any | None:
    try:
        return read_json(record)["result"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def safe_name(key: str) -> str:
    """The name of an item as a part of a file's name; no two items share one."""
    readable = re.sub(r"[^A-Za-z0-9_.-]", "_", key)[:_LONGEST_NAME]
    return f"{readable}-{hash_value(key)[:10]}"
