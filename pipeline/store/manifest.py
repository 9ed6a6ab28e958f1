"""The manifest of a finished stage: what its results depend on, what it wrote, and whether that is still so."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, TypeAdapter, ValidationError

from pipeline.settings.kinds import sentence, shown
from pipeline.store.atomic_files import read_json
from pipeline.store.provenance import hash_file, hash_value, software_versions

MANIFEST = "manifest.json"
MANIFEST_VERSION = 3
_LONGEST_PART = 255  # bytes of a file's name that a file system takes

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Identity:
    """What a result depends on: two runs with the same identity give the same results."""

    config_hash: str
    input_hashes: dict[str, str]  # folder of a stage that was read -> hash of its outputs
    version: int  # of the stage: see `pipeline.stages.Stage`

    @property
    def fingerprint(self) -> str:
        """One hash over all of it."""
        return hash_value(asdict(self))


def _entry(entry: dict[str, Any]) -> dict[str, Any]:
    """Accepts what is known of an output: {"sha256": hex, "bytes": int}."""
    if not isinstance(entry.get("sha256"), str) or not isinstance(entry.get("bytes"), int):
        raise ValueError(f"needs sha256 and bytes of every file, got {shown(entry)}")
    return entry


def is_inside(name: str) -> bool:
    """Whether a name, with slashes, is a path below a folder that any file can have."""
    parts = name.split("/")
    return not any(part in ("", ".", "..") or len(os.fsencode(part)) > _LONGEST_PART or "\0" in part for part in parts)


def _relative(name: str) -> str:
    """Accepts a path below a stage's folder, as `files_below` lists them."""
    if not is_inside(name):
        raise ValueError(f"cannot be {shown(name)}: it is no path below the stage's folder")
    return name


# Path below the stage's folder to what is known of the file: {"sha256": hex, "bytes": int}.
Files = dict[Annotated[str, AfterValidator(_relative)], Annotated[dict[str, Any], AfterValidator(_entry)]]


@dataclass(frozen=True)
class Manifest:
    """The record of a finished stage."""

    stage: str
    run: str
    budget: str
    seed: int
    config: dict[str, Any]
    identity: Identity
    outputs: Files
    wall_time_s: float
    finished: str  # ISO 8601, UTC
    overrides: list[str] = field(default_factory=list)  # that it was run with, e.g. ["seed=1", "stage.episodes=5"]
    jobs: dict[str, dict[str, Any]] = field(default_factory=dict)  # what each of its jobs cost: `pipeline.store.costs`
    variant: list[str] = field(default_factory=list)  # those of them that its folder is named after
    commits: list[str] = field(default_factory=list)  # of the code that made it: see `present_commit`
    versions: dict[str, str] = field(default_factory=software_versions)
    version: int = MANIFEST_VERSION

    @property
    def outputs_hash(self) -> str:
        """Hash of the outputs' contents: what later stages depend on."""
        return hash_value({path: entry["sha256"] for path, entry in self.outputs.items()})

    def changed_output(self, folder: Path) -> str | None:
        """Finds an output that is not as the stage left it: ``runs/desk/expert/results.json is missing``, or None."""
        name = next((name for name, entry in self.outputs.items() if not _holds(folder / name, entry)), None)
        return name and f"{folder / name} {'was changed' if (folder / name).exists() else 'is missing'}"

    def foreign_file(self, folder: Path) -> Path | None:
        """Finds a file that the stage did not write but that readers, who go by endings, would take for its own."""
        endings = {os.path.splitext(name)[1] for name in self.outputs}
        foreign = (n for n in files_below(folder) if n not in self.outputs and os.path.splitext(n)[1] in endings)
        return next((folder / name for name in foreign if name != MANIFEST), None)


_MANIFESTS = TypeAdapter(Manifest)


def entry_of(file: Path) -> dict[str, Any]:
    """What a manifest keeps of a file: SHA-256 in hex, bytes, and when its status changed, ns since the epoch."""
    status = file.stat()
    return {"sha256": hash_file(file), "bytes": status.st_size, "changed_ns": status.st_ctime_ns}


def _holds(file: Path, entry: dict[str, Any]) -> bool:
    """Whether a file is as its entry says; one whose status has not changed since is not read."""
    try:
        status = file.stat()
        same = stat.S_ISREG(status.st_mode) and status.st_size == entry["bytes"]
        return same and (status.st_ctime_ns == entry.get("changed_ns") or hash_file(file) == entry["sha256"])
    except (FileNotFoundError, NotADirectoryError):
        return False


def read_manifest(folder: Path) -> Manifest | None:
    """Reads the manifest of a finished stage; None when it has not finished there or it cannot be read."""
    path = folder / MANIFEST
    try:
        content = read_json(path)
        if content.get("version") != MANIFEST_VERSION:
            _LOGGER.warning("%s is of another version of the project: the stage counts as not run", path)
            return None
        return _MANIFESTS.validate_python(content)
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        reason = sentence(error) if isinstance(error, ValidationError) else error
        _LOGGER.warning("%s cannot be read (%s): the stage counts as not run", path, reason)
        return None


def files_below(folder: Path) -> Iterator[str]:
    """Lists the files of a stage's folder, relative to it with slashes, but its scratch, which begins with a dot."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        inside = Path(place).relative_to(folder)
        yield from ((inside / name).as_posix() for name in sorted(files) if not name.startswith("."))
