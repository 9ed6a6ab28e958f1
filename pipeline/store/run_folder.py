"""The run folder of a stage: lock, manifest, the check whether it is up to date, going on after an interruption.

``runs/<name>/<stage>/`` belongs to one stage; a job of a sweep gets ``runs/<name>/<stage>@<overrides>/`` beside it.
In it:

- ``manifest.json``, written last: a folder without it is unfinished, whatever else lies there.
- ``.progress/``: finished items, so that an interrupted stage goes on where it stopped; see `finished_items`.
- ``.lock``: held while a process works here. The kernel frees it when the process dies, so it never goes stale.
- other names that begin with a dot: what the stage's parts hand to each other. All of it is gone at the end.

``runs/<name>/.old/<stage>-<time>/`` holds results that others replaced: nothing here removes them.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from pipeline.jobs.display import JobDisplay
from pipeline.store.atomic_files import remove_unfinished, write_json, write_text
from pipeline.store.costs import kept_costs
from pipeline.store.errors import StageError
from pipeline.store.finished_items import FinishedItems
from pipeline.store.interruption import stop_if_interrupted
from pipeline.store.manifest import MANIFEST, Identity, Manifest, entry_of, files_below, read_manifest
from pipeline.store.provenance import present_commit

Item = TypeVar("Item")

_LOGGER = logging.getLogger(__name__)
LOCK = ".lock"
_COMMITS, _COMMIT = "commits.txt", re.compile(r"\w{1,40}\+?")
OLD = ".old"  # below the run


class RunFolder(FinishedItems):
    """The folder one stage writes to, while it is being worked on; it is made when missing."""

    def __init__(self, path: Path, identity: Identity) -> None:
        super().__init__(path)
        self.identity = identity

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the folder for this process."""
        self.path.mkdir(parents=True, exist_ok=True)
        place = self.path / LOCK
        if place.is_symlink() or (place.exists() and not place.is_file()):
            raise StageError(f"{place} is no file of this project: remove it")
        if any(self.path.iterdir()) and not place.exists():
            raise StageError(f"{self.path} holds files that no stage wrote: choose another name=… or runs_dir=…")
        with place.open("a+") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.seek(0)
                holder = lock.read().strip() or "another process"
                raise StageError(
                    f"{self.path} is in use by {holder}: wait for it, or give this run another name=…"
                ) from None
            lock.truncate(0)
            lock.write(f"process {os.getpid()} on {os.uname().nodename}")
            lock.flush()
            yield

    def is_up_to_date(self) -> bool:
        """Tells whether the folder holds the results of this identity, each file of the manifest with its content."""
        manifest = read_manifest(self.path)
        if manifest is None or manifest.identity != self.identity:
            return False
        changed = manifest.changed_output(self.path)
        if changed is not None:
            _LOGGER.warning("%s, so the stage runs again", changed)
            return False
        foreign = manifest.foreign_file(self.path)
        if foreign is not None:
            _LOGGER.warning("%s was not written by this stage: move it away, or later stages refuse to read", foreign)
        return True

    def prepare(self, *, force: bool = False) -> int:
        """Readies the folder for work: keeps finished items of the same identity, moves everything else aside.

        What is moved lies in ``runs/<name>/.old/<stage>-<time>/`` until the user removes it.

        Returns:
            How many finished items are kept.
        """
        self._remove_links()
        manifest = self.path / MANIFEST
        if not force and not manifest.exists() and self._belong_to(self.identity.fingerprint):
            remove_unfinished(self.path)
            item_count = self._count()
            self._note_commit(item_count)
            return item_count
        self._move_aside()
        write_json(self._identity_path, self.identity.fingerprint)
        self._note_commit(0)
        return 0

    def _move_aside(self) -> None:
        results = any(files_below(self.path))
        aside = self.path.parent / OLD / f"{self.path.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}"
        # A kill at any point leaves no item and no manifest to trust here, and no file is lost.
        self._revoke()
        for entry in sorted(self.path.iterdir(), key=lambda entry: entry.name != MANIFEST):
            if entry.name == LOCK:
                continue
            if results:
                aside.mkdir(parents=True, exist_ok=True)
                shutil.move(entry, aside / entry.name)  # the folder may be a link to another disk
            else:
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        if results:
            _LOGGER.warning("%s: earlier results were moved to %s, which you may remove", self.path, aside)

    def _note_commit(self, item_count: int) -> None:
        """Adds the present commit to those that the items were made by, and warns of another one."""
        present = present_commit()
        others = [commit for commit in self._commits() if item_count and commit != present]
        if others:
            made = "%s: the %d finished items were made by commit %s, the code is at %s"
            _LOGGER.warning(made, self.path, item_count, ", ".join(others), present)
        write_text(self._place / _COMMITS, "\n".join([*others, present]))

    def _commits(self) -> list[str]:
        path = self._place / _COMMITS
        words = path.read_text("utf-8", "replace").split() if path.is_file() else []
        return [word for word in words if _COMMIT.fullmatch(word)]

    def _remove_links(self) -> None:
        """Removes symbolic links, which no stage makes: through one, a stage would write and delete elsewhere."""
        for place, folders, files in os.walk(self.path):
            for entry in (Path(place, name) for name in (*folders, *files)):
                if entry.is_symlink():
                    _LOGGER.warning("%s is a link, which no stage makes: it is removed", entry)
                    entry.unlink()

    def pending(self, items: Sequence[Item], *, key: Callable[[Item], str] = str) -> list[Item]:
        """Lists the items that are not done yet, for stages that hand them to worker processes themselves."""
        keys = [key(item) for item in items]
        if len(set(keys)) != len(keys):
            raise ValueError(f"items must have different keys, got {keys}")
        return [item for item, name in zip(items, keys, strict=True) if self.result_of(name) is None]

    def resumable(
        self, items: Sequence[Item], *, key: Callable[[Item], str] = str, label: str = "items"
    ) -> Iterator[Item]:
        """Passes on the items that are not done yet, with progress, and marks each as done when the loop comes back.

        An item whose body raises, or during which the process dies, stays to be done. A body with something to hand
        to the summary calls ``mark_done(key, result)`` itself, as its last act.
        """
        todo = self.pending(items, key=key)
        with JobDisplay(label, [key(item) for item in items], [key(item) for item in todo]) as display:
            for item in todo:
                display.states[key(item)].start()
                yield item
                if self.result_of(key(item)) is None:
                    self.mark_done(key(item))
                display.states[key(item)].finish()
                display.show()
                stop_if_interrupted()

    def finish(
        self, *, stage: str, run: str, budget: str, seed: int, config: dict[str, Any], started: float,
        overrides: Sequence[str] = (), variant: Sequence[str] = (),
    ) -> Manifest:  # fmt: skip
        """Writes the manifest, the last act of a stage that began at `started` of ``time.monotonic()``."""
        remove_unfinished(self.path)
        manifest = Manifest(
            stage=stage, run=run, budget=budget, seed=seed, config=config, identity=self.identity,
            overrides=list(overrides), variant=list(variant), jobs=kept_costs(self.path), commits=self._commits(),
            outputs={n: entry_of(self.path / n) for n in files_below(self.path) if n != MANIFEST},
            wall_time_s=round(time.monotonic() - started, 3), finished=datetime.now(UTC).isoformat(timespec="seconds"),
        )  # fmt: skip
        write_json(self.path / MANIFEST, asdict(manifest))
        for entry in self.path.iterdir():
            if entry.name.startswith(".") and entry.name != LOCK and entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)
        return manifest
