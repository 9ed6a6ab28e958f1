"""Model file: what a network is built from and its weights in one file, whole or not there, and checked when read.

::

    sha256 <64 hexadecimal digits of lower case>    one line: the digest of every byte after it
    <what `torch.save` wrote>                       read with `weights_only`, which runs no code

The digest is needed: torch checks no checksum when it reads, so a weight with a wrong bit would be taken as it is.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import torch
from torch import nn

from enn.bounded_content import built_from, load_content, tensors
from enn.networks.devices import on_cpu

Network = TypeVar("Network", bound=nn.Module)
_MARK = b"sha256 "
LARGEST_BYTES = 4 << 30


class ForeignFileError(ValueError):
    """A file does not begin as a model file does, so it was hardly ever one."""


def encoded(content: Any) -> bytes:
    """The bytes of a file, which opens on any device.

    Args:
        content: numbers, strings, lists, tuples, dictionaries and tensors.
    """
    stream = io.BytesIO()
    torch.save(on_cpu(content), stream)
    return _digest_line(stream.getbuffer()) + stream.getvalue()


def decoded(data: bytes) -> Any:
    """The content of what `encoded` gave.

    Raises:
        ForeignFileError: the first bytes are others.
        ValueError: a byte is missing or differs.
    """
    if not data.startswith(_MARK):
        raise ForeignFileError("it does not begin as one")
    body = memoryview(data)[len(_digest_line(b"")) :]
    if data[: len(data) - len(body)] != _digest_line(body):
        raise ValueError("its digest does not match")
    return load_content(body)


def read_bytes(path: Path) -> bytes:
    """The bytes of a file, which must be a regular one and no larger than any model.

    Raises:
        FileNotFoundError: there is no such file, or it is a folder, a pipe or a device.
        ValueError: it is too large.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no file")
    if path.stat().st_size > LARGEST_BYTES:
        raise ValueError(f"it has more than {LARGEST_BYTES >> 30} GB")
    return path.read_bytes()


def write_model(path: Path, content: dict[str, Any]) -> None:
    """Writes a model at once: a reader sees the former file or this one.

    Args:
        path: of the file; its folder is made when missing.
        content: numbers, strings, lists, tuples, dictionaries and tensors, with `format`.

    Raises:
        ValueError: a weight is NaN or infinite; the former file stays.
    """
    spoilt = _not_finite(content)
    if spoilt is not None:
        raise ValueError(f"{path} was not written: {spoilt} is not finite; train it again with a lower learning rate")
    write_whole(path, encoded(content))


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file at once, in a folder that is made when missing: a reader sees the former file or this one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.unlink(missing_ok=True)  # a link of that name would be written through
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def read_model(path: Path, form: str, *, kind: str, verb: str) -> dict[str, Any]:
    """Reads what `write_model` wrote.

    Args:
        form: that `format` must be.
        kind: of model, as messages call it: "policy".

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, holds something else, or a weight is NaN or infinite.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no {kind} {path}: {verb} one first")
    try:
        content = decoded(read_bytes(path))
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): look at the disk, or {verb} it again") from error
    except Exception as error:
        reason = str(error) if isinstance(error, ValueError) else type(error).__name__
        advice = "give the path of one" if isinstance(error, ForeignFileError) else f"{verb} it again"
        raise ValueError(f"{path} is damaged or no {kind} ({reason}): {advice}") from error
    if not isinstance(content, dict) or content.get("format") != form:
        found = content.get("format") if isinstance(content, dict) else None
        got = f"{found!a:.80}" if isinstance(content, dict) else type(content).__name__
        earlier = isinstance(found, str) and found.rpartition("-")[0] == form.rpartition("-")[0]
        advice = f"{verb} it again" if earlier else "give the path of one"
        raise ValueError(f"{path} is no {kind} of format {form}, but {got}: {advice}")
    spoilt = _not_finite(content)
    if spoilt is not None:
        raise ValueError(f"{path}: {spoilt} is not finite: {verb} it again")
    return content


# what building or filling a network raises when the file is of another version
UNFIT = (ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError, ValueError)


def another_architecture(path: Path, error: Exception, *, verb: str) -> ValueError:
    """The error of a file whose weights do not fit its own settings."""
    reason = " ".join(str(error).split())[:200].encode("ascii", "backslashreplace").decode()
    return ValueError(f"{path} is of another architecture than this version builds ({reason}): {verb} it again")


def write_network(path: Path | str, form: str, network: nn.Module, metadata: dict[str, Any] | None = None) -> None:
    """Writes a network's settings and weights, and what else is worth keeping.

    Args:
        form: its `format`.
        network: with a dataclass `settings` that says how to build it.
        metadata: numbers, strings, lists and dictionaries.
    """
    content = {"format": form, "settings": asdict(network.settings), "weights": network.state_dict()}  # type: ignore[call-overload]
    write_model(Path(path), {**content, "metadata": dict(metadata or {})})


def read_network(
    path: Path | str,
    form: str,
    build: Callable[[dict[str, Any]], Network],
    *,
    kind: str,
    verb: str,
    device: torch.device | str = "cpu",
) -> tuple[Network, dict[str, Any]]:
    """Reads what `write_network` wrote.

    Args:
        form: that `format` must be.
        build: makes the network, its weights still to be filled in, from the settings' fields.

    Returns:
        The network, and the metadata.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, holds something else, or its weights do not fit its settings.
    """
    path = Path(path)
    content = read_model(path, form, kind=kind, verb=verb)
    try:
        with built_from(content):
            network = build(content["settings"])
        network.load_state_dict(content["weights"])
        return network.to(device), dict(content["metadata"])
    except UNFIT as error:
        raise another_architecture(path, error, verb=verb) from error


class FittedNetwork(Generic[Network]):
    """A fitted network that predicts, kept in one file; a subclass names the file and builds the network.

    Args:
        network: with a dataclass `settings` that says how to build it.
        metadata: whatever else is worth keeping: numbers, strings, lists and dictionaries.
    """

    FORMAT: ClassVar[str]
    KIND: ClassVar[str]  # of model, as messages call it
    VERB: ClassVar[str]  # what makes one

    def __init__(self, network: Network, metadata: dict[str, Any] | None = None) -> None:
        self.network = network.eval()
        self.metadata = dict(metadata or {})

    @classmethod
    def build(cls, settings: dict[str, Any]) -> Network:
        """The network with fresh weights, from the fields of its settings."""
        raise NotImplementedError

    def save(self, path: Path | str) -> None:
        """Writes settings and weights into one file, atomically."""
        write_network(path, self.FORMAT, self.network, self.metadata)

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> Self:
        """Reads a file of `save` onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, holds something else, or its weights do not fit its settings.
        """
        network, metadata = read_network(path, cls.FORMAT, cls.build, kind=cls.KIND, verb=cls.VERB, device=device)
        return cls(network, metadata)


def _digest_line(body: bytes | memoryview) -> bytes:
    return _MARK + hashlib.sha256(body).hexdigest().encode() + b"\n"


def _not_finite(content: Any) -> str | None:
    """Where the first tensor is that is not finite, if there is one."""
    return next((place for place, tensor in tensors(content) if not bool(torch.isfinite(tensor).all())), None)
