"""Checkpoints: what an unfinished training needs to go on exactly, written so that a kill never spoils it."""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from enn.model_file import decoded, encoded

_SINGLE = (type(None), bool, int, float, str)
_KEYS = (str, int)
Place = tuple[Any, ...]


FORMAT: Final = "enn-checkpoint-2"
INDEX = "index.json"


def plain(state: Any) -> dict[str, Any]:
    """Turns state into what `enn.model_file.encoded` takes.

    Args:
        state: None, numbers, texts, bytes, arrays, tensors, and lists, tuples and dictionaries of them.

    Returns:
        For `restored`.

    Raises:
        TypeError: something else is in it; its place is named.
    """
    kinds: dict[Place, str] = {}
    return {"state": _plain(state, (), kinds), "kinds": kinds}


def restored(content: dict[str, Any]) -> Any:
    """The state that `plain` was given: the same values, arrays in the same order of memory."""
    return _restored(content["state"], (), content["kinds"])


def _plain(value: Any, place: Place, kinds: dict[Place, str]) -> Any:
    if type(value) in _SINGLE:
        return value
    if isinstance(value, torch.Tensor):
        return value.detach()
    if isinstance(value, bytes):
        kinds[place] = "bytes"
        return torch.from_numpy(np.frombuffer(value, np.uint8).copy())
    if isinstance(value, np.ndarray | np.generic):
        kinds[place] = "array" if isinstance(value, np.ndarray) else "scalar"
        try:
            return torch.from_numpy(np.array(value, order="K"))
        except (TypeError, ValueError):
            raise _refused(f"an array of type {value.dtype}", place) from None
    if isinstance(value, dict):
        odd = next((key for key in value if type(key) not in _KEYS), None)
        if odd is not None:
            raise _refused(f"a dictionary with a {type(odd).__name__} as a key", place)
        return {key: _plain(part, (*place, key), kinds) for key, part in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_plain(part, (*place, k), kinds) for k, part in enumerate(value))
    raise _refused(f"a {type(value).__name__}", place)


def _restored(value: Any, place: Place, kinds: dict[Place, str]) -> Any:
    if isinstance(value, torch.Tensor):
        kind = kinds.get(place)
        if kind is None:
            return value
        array = value.numpy()
        return array if kind == "array" else array[()] if kind == "scalar" else array.tobytes()
    if isinstance(value, dict):
        return {key: _restored(part, (*place, key), kinds) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_restored(part, (*place, k), kinds) for k, part in enumerate(value))
    return value


def _refused(what: str, place: Place) -> TypeError:
    name = "/".join(map(str, place)) or "the state"
    return TypeError(
        f"{name} is {what}, which a checkpoint cannot hold: state() of environments may give None, numbers, texts, "
        "bytes, arrays, and lists, tuples and dictionaries of them"
    )


class CheckpointError(ValueError):
    """A checkpoint is damaged, or of a training that this one cannot go on with."""


class _Part(BaseModel):
    """A file of a checkpoint: its name in the folder, and the digest of its bytes."""

    model_config = ConfigDict(extra="forbid", strict=True)
    file: Annotated[str, Field(pattern=r"^[\w.]+-\d+\.(pt|npy)$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _Piece(_Part):
    """A piece of a large array."""

    version: int
    rows: Annotated[int, Field(ge=0)]


class _Index(BaseModel):
    """What a checkpoint consists of."""

    model_config = ConfigDict(extra="forbid", strict=True)
    format: Literal["enn-checkpoint-2"] = FORMAT
    number: Annotated[int, Field(ge=1)]
    architecture: dict[str, Any]
    state: _Part
    pieces: dict[str, _Piece]


class CheckpointFolder:
    """One checkpoint in a folder, replaced as a whole.

        checkpoint/index.json         names, sizes and digests of the files below; written last, by renaming
        checkpoint/state-<n>.pt       weights, optimisers, random states, environments, curve, best policy
        checkpoint/<array>-<n>.npy    pieces of large arrays; those that did not change are kept from before

    All of it is data: reading it runs no code. A killed write leaves files that no index names; the next one removes
    them.

    Args:
        architecture: what has to agree between the training that wrote it and the one that goes on.
    """

    def __init__(self, folder: Path, architecture: dict[str, Any]) -> None:
        self.folder = folder
        self.architecture = json.loads(json.dumps(architecture))
        self._written: dict[str, _Piece] = {}
        self._number = 0

    def exists(self) -> bool:
        """Whether there is one."""
        return (self.folder / INDEX).is_file()

    def write(self, state: dict[str, Any], pieces: Iterable[tuple[str, int, NDArray[Any]]] = ()) -> None:
        """Writes a checkpoint; the former one stays valid until this is complete.

        Args:
            state: what `enn.reinforcement.checkpoint.plain` takes.
            pieces: name, version and array; a piece whose version was written before is not written again.

        Raises:
            TypeError: the state has something in it that is no plain data.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self._number and self.exists():
            self._number = self._index().number
        self._number += 1
        entries: dict[str, _Piece] = {}
        for name, version, array in pieces:
            entry = self._written.get(name)
            # rows are filled in one by one, so an unchanged version has unchanged bytes
            if entry is None or entry.version != version or entry.rows != len(array):
                stream = io.BytesIO()
                np.save(stream, array, allow_pickle=False)
                file = f"{_plain_name(name)}-{self._number}.npy"
                entry = _Piece(file=file, sha256=self._put(file, stream.getvalue()), version=version, rows=len(array))
            entries[name] = entry
        file = f"state-{self._number}.pt"
        part = _Part(file=file, sha256=self._put(file, encoded(plain(state))))
        index = _Index(number=self._number, architecture=self.architecture, state=part, pieces=entries).model_dump()
        temporary = f".{INDEX}.tmp"
        self._put(temporary, json.dumps({"sha256": _digest(index), "index": index}).encode())
        os.replace(self.folder / temporary, self.folder / INDEX)
        self._written = entries
        named = {INDEX, file, *(entry.file for entry in entries.values())}
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
            theirs = index.architecture.get(name)
            if theirs != mine:
                raise CheckpointError(
                    f"the checkpoint in {self.folder} is of another architecture: its {name} is {theirs}, this "
                    f"training's {mine}; take another folder, or remove the checkpoint"
                )
        pieces: dict[str, NDArray[Any]] = {}
        part: _Part = index.state
        try:
            state = restored(decoded(self._bytes(part)))
            for name, part in index.pieces.items():
                pieces[name] = np.load(io.BytesIO(self._bytes(part)), allow_pickle=False)
        except Exception as error:  # whatever else a file with the right digest holds: it is of no use
            raise self.unusable(f"{part.file}: {_reason(error)}") from error
        self._written, self._number = index.pieces, index.number
        return state, pieces

    def unusable(self, reason: str) -> CheckpointError:
        """The error of a checkpoint that cannot be gone on from, and what to do."""
        return CheckpointError(
            f"the checkpoint in {self.folder} is damaged ({reason}): remove it to train from the start"
        )

    def remove(self) -> None:
        """Removes it, once the training is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _put(self, name: str, data: bytes) -> str:
        """Writes a file of the folder; its digest."""
        (self.folder / name).unlink(missing_ok=True)  # a link of that name would be written through
        with (self.folder / name).open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        return hashlib.sha256(data).hexdigest()

    def _bytes(self, part: _Part) -> bytes:
        data = (self.folder / part.file).read_bytes()
        if hashlib.sha256(data).hexdigest() != part.sha256:
            raise ValueError("its digest does not match")
        return data

    def _index(self) -> _Index:
        try:
            content = json.loads((self.folder / INDEX).read_text(encoding="utf-8"))
            if content["sha256"] == _digest(content["index"]):
                return _Index.model_validate(content["index"])
        except (KeyError, OSError, RecursionError, TypeError, ValueError) as error:
            raise self.unusable(INDEX) from error
        raise self.unusable(f"{INDEX}: its digest does not match")


def random_states() -> dict[str, Any]:
    """The global generators' states: training draws from generators of its own, but libraries may use these."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [],
    }


def restore_random_states(states: dict[str, Any]) -> None:
    """Returns the global generators to saved states."""
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])
    if states["cuda"] and torch.cuda.is_available() and len(states["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(states["cuda"])


def _digest(index: Any) -> str:
    return hashlib.sha256(json.dumps(index, sort_keys=True).encode()).hexdigest()


def _plain_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._" else "_" for letter in name)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
