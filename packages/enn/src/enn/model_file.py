"""Model file: what a network is built from and its weights in one file, whole or not there, and checked when read."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

Network = TypeVar("Network", bound=nn.Module)


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


def write_network(path: Path | str, form: str, network: nn.Module, metadata: dict[str, Any] | None = None) -> None:
    """Writes a network's settings and weights, and what else is worth keeping.

    Args:
        path: of the file.
        form: its `format`.
        network: with a dataclass `settings` that says how to build it.
        metadata: numbers, strings, lists and dictionaries.
    """
    content = {"format": form, "settings": asdict(network.settings), "weights": network.state_dict()}  # type: ignore[call-overload]
    write_model(Path(path), {**content, "metadata": dict(metadata or {})})


def read_network(
    path: Path | str, form: str, build: Callable[[dict[str, Any]], Network], *, kind: str, verb: str
) -> tuple[Network, dict[str, Any]]:
    """Reads what `write_network` wrote.

    Args:
        path: of the file.
        form: that `format` must be.
        build: makes the network, its weights still to be filled in, from the settings' fields.
        kind: of model, as messages call it.
        verb: what makes one.

    Returns:
        The network, and the metadata.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, holds something else, or its weights do not fit its settings.
    """
    path = Path(path)
    content = read_model(path, form, kind=kind, verb=verb)
    try:
        network = build(content["settings"])
        network.load_state_dict(content["weights"])
    except (TypeError, RuntimeError, ValueError) as error:
        raise another_architecture(path, error, verb=verb) from error
    return network, content["metadata"]
