"""The run folder of a stage: lock, manifest, the check whether it is up to date, going on after an interruption.

``runs/<name>/<stage>/`` belongs to one stage; a job of a sweep gets ``runs/<name>/<stage>@<overrides>/`` beside it.
In it:

- ``manifest.json``, written last: a folder without it is unfinished, whatever else lies there.
- ``.progress/``: one file a finished item, so that an interrupted stage goes on where it stopped; gone at the end.
- ``.lock``: held while a process works here. The kernel frees it when the process dies, so it never goes stale.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from pipeline.atomic import atomic_path, remove_unfinished, write_json
from pipeline.errors import FolderBusyError, StageError
from pipeline.interruption import stop_if_asked
from pipeline.progress import progress
from pipeline.provenance import git_state, hash_file, hash_value, software_versions

Item = TypeVar("Item")

MANIFEST = "manifest.json"
MANIFEST_VERSION = 1
_PROGRESS = ".progress"
_LOCK = ".lock"

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Identity:
    """What a result depends on: two runs with the same identity give the same results."""

    config_hash: str
    input_hashes: dict[str, str]  # stage -> hash of its outputs
    code_hash: str

    @property
    def fingerprint(self) -> str:
        """One hash over all of it."""
        return hash_value(asdict(self))


@dataclass(frozen=True)
class Manifest:
    """The record of a finished stage."""

    stage: str
    run: str
    budget: str
    seed: int
    config: dict[str, Any]
    identity: Identity
    outputs: dict[str, dict[str, Any]]  # relative path -> {"sha256": hex, "bytes": int}
    wall_time_s: float
    finished: str  # ISO 8601, UTC
    git: dict[str, Any] = field(default_factory=git_state)
    versions: dict[str, str] = field(default_factory=software_versions)
    version: int = MANIFEST_VERSION

    @property
    def outputs_hash(self) -> str:
        """Hash of the outputs' contents: what later stages depend on."""
        return hash_value({path: entry["sha256"] for path, entry in self.outputs.items()})


def read_manifest(folder: Path) -> Manifest | None:
    """Reads the manifest of a finished stage.

    Args:
        folder: the stage's run folder.

    Returns:
        The manifest, or None when the stage has not finished there or its manifest cannot be read.
    """
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("version") != MANIFEST_VERSION:
            return None
        return Manifest(**{**content, "identity": Identity(**content["identity"])})
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        _LOGGER.warning("%s cannot be read (%s): the stage counts as not run", path, error)
        return None


class RunFolder:
    """The folder one stage writes to, while it is being worked on."""

    def __init__(self, path: Path, identity: Identity) -> None:
        """Args:
        path: the folder; it is made when missing.
        identity: what the results will depend on.
        """
        self.path = path
        self.identity = identity
        self._results: dict[str, Any] = {}

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the folder for this process.

        Raises:
            FolderBusyError: when another process holds it.
            StageError: when the folder holds files that no stage wrote: working here would remove them.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        if any(self.path.iterdir()) and not (self.path / _LOCK).exists():
            raise StageError(f"{self.path} holds files that no stage wrote: choose another name=… or runs_dir=…")
        with (self.path / _LOCK).open("a+") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.seek(0)
                holder = lock.read().strip() or "another process"
                raise FolderBusyError(
                    f"{self.path} is in use by {holder}: wait for it, or give this run another name=…"
                ) from None
            lock.truncate(0)
            lock.write(f"process {os.getpid()} on {os.uname().nodename}")
            lock.flush()
            yield

    def is_up_to_date(self) -> bool:
        """Tells whether the folder holds the finished results of this identity.

        Returns:
            True when the manifest matches and every file it lists is there with its size.
        """
        manifest = read_manifest(self.path)
        if manifest is None or manifest.identity != self.identity:
            return False
        for name, entry in manifest.outputs.items():
            file = self.path / name
            if not file.is_file() or file.stat().st_size != entry["bytes"]:
                _LOGGER.info("%s is missing or was changed", file)
                return False
        return True

    def prepare(self, *, force: bool = False) -> int:
        """Readies the folder for work: keeps finished items of the same identity, removes everything else.

        Args:
            force: start from nothing even when finished items could be kept.

        Returns:
            How many finished items are kept.
        """
        (self.path / MANIFEST).unlink(missing_ok=True)  # first: from here on the folder is unfinished
        marker = self.path / _PROGRESS / "identity.json"
        with contextlib.suppress(FileNotFoundError, ValueError):
            if not force and json.loads(marker.read_text()) == self.identity.fingerprint:
                remove_unfinished(self.path)
                return sum(1 for _ in marker.parent.glob("item-*.json"))
        for entry in self.path.iterdir():
            if entry.name != _LOCK:
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        write_json(marker, self.identity.fingerprint)
        return 0

    def result_of(self, key: str) -> Any | None:
        """What a finished item left for the stage's summary.

        Args:
            key: the item's key.

        Returns:
            The value given to ``mark_done`` ({} when none was), or None while the item is not done.
        """
        if key not in self._results:
            with contextlib.suppress(FileNotFoundError, ValueError):
                self._results[key] = json.loads(self._item_file(key).read_text(encoding="utf-8"))["result"]
        return self._results.get(key)

    def pending(self, items: Sequence[Item], *, key: Callable[[Item], str] = str) -> list[Item]:
        """Lists the items that are not done yet, for stages that hand them to worker processes themselves.

        Args:
            items: all items of the stage.
            key: names an item; names must differ.

        Returns:
            Those to do, in order.

        Raises:
            ValueError: when two items have the same key.
        """
        keys = [key(item) for item in items]
        if len(set(keys)) != len(keys):
            raise ValueError(f"items must have different keys, got {keys}")
        return [item for item, name in zip(items, keys, strict=True) if self.result_of(name) is None]

    def mark_done(self, key: str, result: Any = None) -> None:
        """Records that an item is finished; call it after its files are written.

        Args:
            key: the item's key.
            result: JSON value that the stage wants back in its summary, also after an interruption.
        """
        kept = {} if result is None else result
        write_json(self._item_file(key), {"key": key, "result": kept})
        self._results[key] = kept

    def resumable(
        self, items: Sequence[Item], *, key: Callable[[Item], str] = str, label: str = "items"
    ) -> Iterator[Item]:
        """Passes on the items that are not done yet, with progress, and marks each as done when the loop comes back.

        An item whose body raises, or during which the process dies, stays to be done. A body with something to hand
        to the summary calls ``mark_done(key, result)`` itself.

        Args:
            items: all items of the stage.
            key: names an item; names must differ.
            label: what the items are, for the progress line.

        Yields:
            Each unfinished item.
        """
        todo = self.pending(items, key=key)
        for item in progress(todo, label, done_before=len(items) - len(todo)):
            yield item
            if self.result_of(key(item)) is None:
                self.mark_done(key(item))
            stop_if_asked()

    def finish(
        self, *, stage: str, run: str, budget: str, seed: int, config: dict[str, Any], started: float
    ) -> Manifest:
        """Writes the manifest, the last act of a stage.

        Args:
            stage: its name.
            run: the run's name.
            budget: the budget's name.
            seed: the run's seed.
            config: the stage's settings.
            started: ``time.monotonic()`` when the work began.

        Returns:
            The manifest as written.
        """
        remove_unfinished(self.path)
        manifest = Manifest(
            stage=stage, run=run, budget=budget, seed=seed, config=config, identity=self.identity,
            outputs=self._outputs(), wall_time_s=round(time.monotonic() - started, 3),
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
        )  # fmt: skip
        with atomic_path(self.path / MANIFEST) as temporary:
            temporary.write_text(json.dumps(asdict(manifest), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        shutil.rmtree(self.path / _PROGRESS, ignore_errors=True)
        return manifest

    def _outputs(self) -> dict[str, dict[str, Any]]:
        files = sorted(p for p in self.path.rglob("*") if p.is_file())
        relative = {p.relative_to(self.path).as_posix(): p for p in files}
        return {
            name: {"sha256": hash_file(path), "bytes": path.stat().st_size}
            for name, path in relative.items()
            if name not in (MANIFEST, _LOCK) and not name.startswith(f"{_PROGRESS}/")
        }

    def _item_file(self, key: str) -> Path:
        safe = re.sub(r"[^A-Za-z0-9_.-]", "_", key)[:80]
        return self.path / _PROGRESS / f"item-{safe}-{hash_value(key)[:10]}.json"


def require_input(run_path: Path, stage: str, reader: str) -> tuple[Path, Manifest]:
    """Finds the finished results of an earlier stage.

    Args:
        run_path: the folder of the run.
        stage: the earlier stage.
        reader: the stage that needs them.

    Returns:
        Its folder and its manifest.

    Raises:
        StageError: when it has not finished; the message names the command to run.
    """
    manifest = read_manifest(run_path / stage)
    if manifest is None:
        raise StageError(
            f"stage {reader} needs the results of stage {stage}, and {run_path / stage} holds none: "
            f"run `python -m pipeline stage={stage} name={run_path.name}` first"
        )
    return run_path / stage, manifest
