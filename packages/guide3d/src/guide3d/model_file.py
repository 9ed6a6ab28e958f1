"""Model file: a network's size, preprocessing and weights in one file, whole or not there, and checked when read.

::

    format        "guide3d-network-1"
    kind          "shape", "fgrn" or "segmentation"
    network       what `guide3d.build` makes the network from: numbers, strings, lists
    preprocessing fields of `guide3d.preprocessing.Preprocessing`
    metadata      what else is known: data, training, versions
    weights       the network's state dictionary; normalisation is part of it
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn

from guide3d.atomic_file import whole_file

FORMAT = "guide3d-network-1"


def write_model(
    path: Path | str,
    *,
    kind: str,
    network: dict[str, Any],
    preprocessing: dict[str, Any],
    module: nn.Module,
    metadata: dict[str, Any] | None = None,
) -> None:
    """Writes a network; a reader sees the former file or this one.

    Args:
        path: of the file; its folder is made when missing.
        kind: of the network.
        network: what it is built from.
        preprocessing: of its images.
        module: whose weights are kept.
        metadata: numbers and strings.
    """
    content = {
        "format": FORMAT,
        "kind": kind,
        "network": network,
        "preprocessing": preprocessing,
        "metadata": metadata or {},
        "weights": {name: value.detach().cpu() for name, value in module.state_dict().items()},
    }
    with whole_file(path) as file:
        torch.save(content, file)


def read_model(path: Path | str, kind: str) -> dict[str, Any]:
    """Reads what `write_model` wrote.

    Args:
        path: of the file.
        kind: of network that it must be.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or holds something else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no network {path}: train one first")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise ValueError(f"{path} is damaged or no network ({type(error).__name__}): train it again") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is no network of format {FORMAT}: train it again")
    if content["kind"] != kind:
        raise ValueError(f"{path} is a network of kind {content['kind']}, expected {kind}: give the other file")
    return content
