"""Checkpoints: what an unfinished training needs to go on exactly, written so that a kill never spoils it."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from enn.devices import on_cpu

FORMAT = "enn-checkpoint-1"
INDEX = "index.json"


class CheckpointError(ValueError):
    """A checkpoint is damaged, or of a training that this one cannot go on with."""


class CheckpointFolder:
    """One checkpoint in a folder, replaced as a whole.

        checkpoint/index.json         names, sizes and checksums of the files below; written last, by renaming
        checkpoint/state-<n>.pt       weights, optimisers, random states, environments, curve, best policy
        checkpoint/<array>-<n>.npy    pieces of large arrays; those that did not change are kept from before

    A killed write leaves files that no index names; the next one removes them.

    Args:
        folder: where it lives.
        architecture: what has to agree between the training that wrote it and the one that goes on.
    """

    def __init__(self, folder: Path, architecture: dict[str, Any]) -> None:
        self.folder = folder
        self.architecture = json.loads(json.dumps(architecture))
        self._written: dict[str, dict[str, Any]] = {}
        self._number = 0

    def exists(self) -> bool:
        """Whether there is one."""
        return (self.folder / INDEX).is_file()

    def write(self, state: dict[str, Any], pieces: Iterable[tuple[str, int, NDArray[Any]]] = ()) -> None:
        """Writes a checkpoint; the former one stays valid until this is complete.

        Args:
            state: anything that pickles.
            pieces: name, version and array; a piece whose version was written before is not written again.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self._number and self.exists():
            self._number = int(self._index()["number"])
        self._number += 1
        entries: dict[str, dict[str, Any]] = {}
        for name, version, array in pieces:
            entry = self._written.get(name)
            if entry is None or entry["version"] != version or entry["rows"] != len(array):
                file = self.folder / f"{_plain(name)}-{self._number}.npy"
                with file.open("wb") as stream:
                    np.save(stream, array, allow_pickle=False)
                    _flush(stream)
                # rows are filled in one by one, so an unchanged version has unchanged bytes
                checksum = zlib.adler32(np.ascontiguousarray(array).data.cast("B"))
                entry = {"file": file.name, "version": version, "rows": len(array), "checksum": checksum}
            entries[name] = entry
        file = self.folder / f"state-{self._number}.pt"
        with file.open("wb") as stream:
            torch.save(on_cpu(state), stream)
            _flush(stream)
        index = {
            "format": FORMAT,
            "number": self._number,
            "architecture": self.architecture,
            "state": {"file": file.name, "checksum": zlib.adler32(file.read_bytes())},
            "pieces": entries,
        }
        temporary = self.folder / f".{INDEX}.tmp"
        with temporary.open("w") as stream:
            json.dump(index, stream)
            _flush(stream)
        os.replace(temporary, self.folder / INDEX)
        self._written = entries
        named = {INDEX, file.name, *(entry["file"] for entry in entries.values())}
        for other in self.folder.iterdir():
            if other.name not in named:
                other.unlink(missing_ok=True)

    def read(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Reads the checkpoint: the state, and the large arrays' pieces by name.

        Raises:
            CheckpointError: it is damaged, or of another architecture.
        """
        index = self._index()
        for name, mine in self.architecture.items():
            theirs = index["architecture"].get(name)
            if theirs != mine:
                raise CheckpointError(
                    f"the checkpoint in {self.folder} is of another architecture: its {name} is {theirs}, this "
                    f"training's {mine}; take another folder, or remove the checkpoint"
                )
        entry: dict[str, Any] = index["state"]
        file = self.folder / entry["file"]
        try:
            data = file.read_bytes()
            if zlib.adler32(data) != entry["checksum"]:
                raise ValueError("its checksum differs")
            with file.open("rb") as stream:
                state = torch.load(stream, map_location="cpu", weights_only=False)
            pieces: dict[str, NDArray[Any]] = {}
            for name, entry in index["pieces"].items():
                file = self.folder / entry["file"]
                array = np.load(file, allow_pickle=False)
                if zlib.adler32(np.ascontiguousarray(array).data.cast("B")) != entry["checksum"]:
                    raise ValueError("its checksum differs")
                pieces[name] = array
        except (OSError, ValueError, EOFError, RuntimeError, pickle.UnpicklingError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise CheckpointError(
                f"the checkpoint in {self.folder} is damaged ({file.name}: {reason}): remove it to train from the start"
            ) from error
        self._written, self._number = index["pieces"], int(index["number"])
        return state, pieces

    def remove(self) -> None:
        """Removes it, once the training is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _index(self) -> dict[str, Any]:
        try:
            index = json.loads((self.folder / INDEX).read_text())
        except (OSError, ValueError) as error:
            raise CheckpointError(
                f"the checkpoint in {self.folder} is damaged ({INDEX}): remove it to train from the start"
            ) from error
        if not isinstance(index, dict) or index.get("format") != FORMAT:
            raise CheckpointError(
                f"the checkpoint in {self.folder} is not of format {FORMAT}: remove it to train from the start"
            )
        return index


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._" else "_" for letter in name)


def _flush(stream: Any) -> None:
    stream.flush()
    os.fsync(stream.fileno())
