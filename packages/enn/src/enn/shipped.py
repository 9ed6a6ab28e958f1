"""Shipped policies: trained weights in the installed package, found by name and without a network connection.

A policy is two files in ``enn/weights``: ``<name>.pt``, and ``<name>.md``, its card, which says what it sees, what it
was trained on, how well it did, and where it fails.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch

    from enn.imitation.images.policy import ImagePolicy
    from enn.policy import Policy

_SUFFIX, _CARD = ".pt", ".md"


def models() -> dict[str, str]:
    """The shipped policies: name to a sentence that says what each does."""
    return {name: _sentence(name) for name in sorted(_names())}


def card(name: str) -> str:
    """The card of a shipped policy, as Markdown.

    Raises:
        ValueError: there is none of this name; the message lists those that there are.
    """
    _require(name)
    return files("enn.weights").joinpath(name + _CARD).read_text(encoding="utf-8")


def load(name: str, device: torch.device | str = "cpu") -> Policy | ImagePolicy:
    """Loads a shipped policy onto a device.

    Args:
        name: one of `models`.

    Returns:
        With `keys`, the observations that it sees, `action_repeat`, and `controller()`, which steers an episode.

    Raises:
        ValueError: there is none of this name, or its file is damaged or of a format that this version does not read.
    """
    _require(name)
    with as_file(files("enn.weights") / (name + _SUFFIX)) as path:
        return read_policy(path, device)


def read_policy(path: Path, device: torch.device | str = "cpu") -> Policy | ImagePolicy:
    """Reads a policy's file, whichever kind it is of.

    Raises:
        ValueError: it is damaged, or of a format that this version does not read.
    """
    from enn.imitation.images.policy import ImagePolicy
    from enn.imitation.recurrent_policy import FORMAT as IMAGE_FORMAT
    from enn.policy import Policy

    # a file of no known format is damaged: the reader says so
    return ImagePolicy.load(path, device) if _format_of(path) == IMAGE_FORMAT else Policy.load(path, device)


def weight_files() -> list[Path]:
    """The files of the shipped policies, by name; none where the package lies in an archive."""
    entries = (Path(str(files("enn.weights") / (name + _SUFFIX))) for name in sorted(_names()))
    return [path for path in entries if path.is_file()]


def _names() -> list[str]:
    entries = files("enn.weights").iterdir()
    return [entry.name.removesuffix(_SUFFIX) for entry in entries if entry.name.endswith(_SUFFIX)]


def _require(name: str) -> None:
    known = sorted(_names())
    if name not in known:
        raise ValueError(f"there is no model {name!r}: choose from {', '.join(known) or 'none, as none is shipped'}")


def _sentence(name: str) -> str:
    """The first paragraph below the title of a card."""
    return " ".join(f"\n{card(name)}".split("\n# ", 1)[1].split("\n\n")[1].split())


def _format_of(path: Path) -> Any:
    from enn.model_file import decoded, read_bytes

    try:
        content = decoded(read_bytes(path))
    except Exception:  # a damaged file: what torch raises is not of one kind
        return None
    return content.get("format") if isinstance(content, dict) else None
