"""Model file: a network's size, preprocessing and weights in one file, whole or not there, and checked when read.

::

    sha256 <64 hexadecimal digits of lower case>    one line: the digest of every byte after it
    <what `torch.save` wrote>                       read with `weights_only`, which runs no code

The digest is needed: torch checks no checksum when it reads, so a weight with a wrong bit would be taken as it is.
What a network's file holds::

    format        "guide3d-network-1"
    kind          "shape", "fgrn" or "segmentation"
    network       what `guide3d.learning.build` makes the network from: numbers, strings, lists
    preprocessing fields of `guide3d.learning.picture_store.Preprocessing`
    metadata      what else is known: data, training, versions
    weights       the network's state dictionary; normalisation is part of it
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from guide3d.files import whole_file
from guide3d.guarded_reading import open_regular
from guide3d.learning.bounded_content import load_content, tensors

FORMAT = "guide3d-network-1"
LARGEST_BYTES = 4 << 30
_PARTS = ("network", "preprocessing", "metadata", "weights")
_MARK = b"sha256 "


class ForeignFileError(ValueError):
    """A file does not begin as a model file does, so it was hardly ever one."""


def write_content(path: Path | str, content: Any) -> None:
    """Writes numbers, strings, lists, tuples, dictionaries and tensors; a reader sees the former file or this one."""
    stream = io.BytesIO()
    torch.save(tree_map_only(Tensor, lambda tensor: tensor.detach().cpu(), content), stream)  # opens on any device
    with whole_file(path) as file:
        file.write(_digest_line(stream.getbuffer()))
        file.write(stream.getbuffer())


def read_content(path: Path | str) -> Any:
    """Reads what `write_content` wrote, its tensors on the CPU.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no regular file, a byte is missing or differs, or it holds something else than plain numbers.
    """
    with open_regular(Path(path), LARGEST_BYTES) as file:
        data = file.read()
    if not data.startswith(_MARK):
        raise ForeignFileError("it does not begin as one")
    body = memoryview(data)[len(_digest_line(b"")) :]
    if data[: len(data) - len(body)] != _digest_line(body):
        raise ValueError("its digest does not match")
    return load_content(body)


def write_model(
    path: Path | str,
    *,
    kind: str,
    network: dict[str, Any],
    preprocessing: dict[str, Any],
    module: nn.Module,
    metadata: dict[str, Any] | None = None,
) -> None:
    """Writes a network; a reader sees the former file or this one. The folder is made when missing.

    Raises:
        ValueError: a weight is NaN or infinite; the former file stays.
    """
    weights = {name: value.detach().cpu() for name, value in module.state_dict().items()}
    spoilt = _not_finite(weights)
    if spoilt is not None:
        raise ValueError(f"{path} was not written: {spoilt} is not finite; train it again with a lower learning rate")
    content = {
        "format": FORMAT,
        "kind": kind,
        "network": network,
        "preprocessing": preprocessing,
        "metadata": metadata or {},
        "weights": weights,
    }
    write_content(path, content)


def read_model(path: Path | str, kind: str) -> dict[str, Any]:
    """Reads what `write_model` wrote of a network of a kind.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, holds something else, or a weight is NaN or infinite.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no network {path}: train one first")
    try:
        content = read_content(path)
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): look at the disk, or train it again") from error
    except Exception as error:
        reason = str(error) if isinstance(error, ValueError) else type(error).__name__
        advice = "give the path of one" if isinstance(error, ForeignFileError) else "train it again"
        raise ValueError(f"{path} is damaged or no network ({reason}): {advice}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        got = f"{content.get('format')!a:.80}" if isinstance(content, dict) else type(content).__name__
        raise ValueError(f"{path} is no network of format {FORMAT}, but {got}: give the path of one")
    if content.get("kind") != kind:
        file_kind = f"{content.get('kind')!a:.80}"
        raise ValueError(f"{path} is a network of kind {file_kind}, expected {kind}: give the other file")
    missing = [name for name in _PARTS if not isinstance(content.get(name), dict)]
    if missing:
        raise ValueError(f"{path} is no whole network, without {', '.join(missing)}: train it again")
    spoilt = _not_finite(content["weights"])
    if spoilt is not None:
        raise ValueError(f"{path}: {spoilt} is not finite: train it again")
    return content


# what building or filling a network raises when the file is of another version
UNFIT = (ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError, ValueError)


def another_architecture(path: Path | str, error: Exception) -> ValueError:
    """The error of a file whose weights do not fit its own settings; `error`: what building or filling raised."""
    reason = " ".join(str(error).split())[:200].encode("ascii", "backslashreplace").decode()
    return ValueError(f"{path} is of another architecture than this version builds ({reason}): train it again")


def _digest_line(body: bytes | memoryview) -> bytes:
    return _MARK + hashlib.sha256(body).hexdigest().encode() + b"\n"


def _not_finite(weights: dict[str, Any]) -> str | None:
    """The first weight that is not finite, if there is one."""
    return next((name for name, value in tensors(weights) if not bool(torch.isfinite(value).all())), None)
