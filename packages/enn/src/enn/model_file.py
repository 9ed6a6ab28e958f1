"""Model file: what a network is built from and its weights in one file, whole or not there, and checked when read."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import torch


def write_model(path: Path, content: dict[str, Any]) -> None:
    """Writes a model at once: a reader sees the former file or this one.

    Args:
        path: of the file; its folder is made when missing.
        content: numbers, strings, lists, tuples, dictionaries and tensors, with `format`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    torch.save(content, temporary)
    os.replace(temporary, path)


def read_model(path: Path, form: str, *, kind: str, verb: str, device: str = "cpu") -> dict[str, Any]:
    """Reads what `write_model` wrote.

    Args:
        path: of the file.
        form: that `format` must be.
        kind: of model, as messages call it: "policy".
        verb: what makes one: "train".
        device: where its tensors go.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or holds something else.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no {kind} {path}: {verb} one first")
    try:
        content = torch.load(path, map_location=device, weights_only=True)
    except Exception as error:
        raise ValueError(f"{path} is damaged or no {kind} ({type(error).__name__}): {verb} it again") from error
    if not isinstance(content, dict) or content.get("format") != form:
        got = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise ValueError(f"{path} is no {kind} of format {form}, but {got}: {verb} it again")
    return content


def another_architecture(path: Path, error: Exception, *, verb: str) -> ValueError:
    """The error of a file whose weights do not fit its own settings.

    Args:
        path: of the file.
        error: what building or filling the network raised.
        verb: what makes a model of this kind.
    """
    reason = " ".join(str(error).split())[:200]
    return ValueError(f"{path} is of another architecture than this version builds ({reason}): {verb} it again")
