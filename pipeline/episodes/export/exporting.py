"""Export of a folder of logs: all of them or nothing appears under the name of the result."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from pipeline.episodes.export.hdf5 import FILE, Hdf5Writer, MinariWriter
from pipeline.episodes.export.layout import ExportError, common_layout, open_episode
from pipeline.episodes.export.lerobot import LeRobotWriter
from pipeline.store.atomic_files import TEMPORARY_PREFIX
from pipeline.store.errors import is_no_room

WRITERS: dict[str, Callable[[Path, Any, str], Any]] = {
    "lerobot": LeRobotWriter,
    "minari": MinariWriter,
    "hdf5": Hdf5Writer,
}
_ROOM = 4  # sizes of a compressed log that its export takes at most
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_]*(-[A-Za-z0-9_]+)*")


@dataclass(frozen=True)
class ExportReport:
    """What an export has written."""

    destination: Path
    episodes: int
    steps: int
    hint: str  # how it is opened


def logs_below(folder: Path) -> list[Path]:
    """Find the finished logs in a folder and below it, by name; an ExportError where there is none."""
    if not folder.is_dir():
        raise ExportError(f"{folder} is no folder: give one with episode logs")
    logs = sorted(
        path for path in folder.rglob("*.mcap")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )  # fmt: skip
    if not logs:
        raise ExportError(f"{folder} holds no episode log (*.mcap): give a folder of a run or a recording")
    return logs


def export_logs(
    folder: Path,
    kind: str,
    destination: Path,
    *,
    name: str | None = None,
    pictures: bool = True,
    masks: bool = False,
    overwrite: bool = False,
) -> ExportReport:
    """Export all logs of a folder and below it as one data set.

    Args:
        kind: "lerobot", "minari" or "hdf5".
        destination: folder of the result; it appears when all is written.
        name: of the data set; None: that of the destination.
        pictures: with images; without, numbers alone.
        masks: also with the masks of the devices.
        overwrite: replace a destination that is there.

    Raises:
        ExportError: no log, logs that differ, a destination that is there, a missing package, or no room.
        EpisodeReadError: a log is damaged.
    """
    if kind not in WRITERS:
        raise ExportError(f"unknown format {kind!r}: choose {', '.join(WRITERS)}")
    logs = logs_below(folder)
    name = destination.name if name is None else name
    if not _NAME.fullmatch(name):
        raise ExportError(f"a data set cannot be called {name!r}: use letters, digits, _ and - (--name)")
    if folder.resolve().is_relative_to(destination.resolve()):
        raise ExportError(f"{destination} holds the logs, which it would replace: give another folder")
    if masks and not pictures:
        raise ExportError("masks are pictures: ask for both, or for neither")
    if destination.exists() and not overwrite and (destination.is_file() or any(destination.iterdir())):
        raise ExportError(f"{destination} is there already: give another folder, or --overwrite to replace it")
    layout = common_layout(logs, pictures=pictures, masks=masks)
    steps = 0
    try:
        with _whole_folder(destination) as temporary, WRITERS[kind](temporary, layout, name) as writer:
            for path in tqdm(logs, desc=f"export to {kind}", unit="episode", disable=None):
                # Free space is checked before the file is written, since HDF5's library crashes on a full disk.
                if shutil.disk_usage(temporary).free < _ROOM * path.stat().st_size + 2**20:
                    raise OSError(errno.ENOSPC, "no room is left")
                with open_episode(path, layout) as episode:
                    writer.add(episode)
                    steps += episode.steps
            writer.finish()
    except OSError as error:
        reason = "no room is left" if is_no_room(error) else error.strerror or str(error)
        raise ExportError(f"cannot write {destination}: {reason}; nothing was left there") from error
    return ExportReport(destination, len(logs), steps, _hint(kind, destination, name))


def _hint(kind: str, destination: Path, name: str) -> str:
    if kind == "lerobot":
        return f'LeRobotDataset("{name}", root="{destination}")'
    if kind == "minari":
        return f'MINARI_DATASETS_PATH={destination.absolute()} and minari.load_dataset("{name}-v0")'
    return f'h5py.File("{destination / FILE}")'


@contextmanager
def _whole_folder(destination: Path) -> Iterator[Path]:
    """Lends a temporary folder beside the destination, which it replaces once the body has ended without an error."""
    destination.parent.mkdir(parents=True, exist_ok=True)
    _remove_left_behind(destination)
    temporary = destination.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{destination.name}")
    temporary.mkdir()
    try:
        yield temporary
        old = destination.with_name(f"{temporary.name}.old")
        if destination.exists():
            os.replace(destination, old)
        os.replace(temporary, destination)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _remove_left_behind(destination: Path) -> None:
    """Removes the temporary folders of exports to the same destination that were killed."""
    for folder in destination.parent.glob(f"{TEMPORARY_PREFIX}*-{destination.name}"):
        number = folder.name.removeprefix(TEMPORARY_PREFIX).split("-", 1)[0]
        if number.isdigit() and not _runs(int(number)):
            shutil.rmtree(folder, ignore_errors=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
