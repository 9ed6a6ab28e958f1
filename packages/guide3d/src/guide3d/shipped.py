"""Shipped networks: trained weights in the installed package, found by name and without a network connection.

A network is two files in ``guide3d/weights``: ``<name>.pt``, and ``<name>.md``, its card, which says what it sees, what
it was trained on, how well it did, and where it fails. splineformer keeps its own in the same way.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guide3d.learning.predictor import SegmentationPredictor, ShapePredictor
    from guide3d.reading.maps import Reader

PACKAGE = "guide3d"
_SUFFIX, _CARD = ".pt", ".md"


def models(package: str = PACKAGE) -> dict[str, str]:
    """The shipped networks of a package: name to a sentence that says what each does."""
    return {name: _sentence(card(name, package)) for name in _names(package)}


def card(name: str, package: str = PACKAGE) -> str:
    """The card of a shipped network, as Markdown.

    Raises:
        ValueError: there is none of this name; the message lists those that there are.
    """
    _require(name, package)
    return files(f"{package}.weights").joinpath(name + _CARD).read_text(encoding="utf-8")


def load(name: str) -> Reader | SegmentationPredictor | ShapePredictor:
    """Loads a shipped network.

    Args:
        name: one of `models`.

    Raises:
        ValueError: there is none of this name, or its file is damaged or of a format that this version does not read.
    """
    with shipped_file(name) as path:
        from guide3d.learning.model_file import read_content
        from guide3d.learning.predictor import SegmentationPredictor, ShapePredictor
        from guide3d.reading.maps import KIND, Reader

        readers: dict[str, Any] = {KIND: Reader, **{one.kind: one for one in (SegmentationPredictor, ShapePredictor)}}
        try:
            kind = read_content(path)["kind"]
        except Exception:  # what torch raises is not of one kind
            kind = KIND  # of a damaged file any reader says what is wrong
        return readers.get(kind, Reader).load(path)


def shipped_file(name: str, package: str = PACKAGE) -> AbstractContextManager[Path]:
    """The file of a shipped network, as long as the context lasts.

    Raises:
        ValueError: there is none of this name.
    """
    _require(name, package)
    return as_file(files(f"{package}.weights") / (name + _SUFFIX))


def _names(package: str) -> list[str]:
    entries = files(f"{package}.weights").iterdir()
    return sorted(entry.name.removesuffix(_SUFFIX) for entry in entries if entry.name.endswith(_SUFFIX))


def _require(name: str, package: str) -> None:
    known = _names(package)
    if name not in known:
        raise ValueError(f"there is no model {name!r}: choose from {', '.join(known) or 'none, as none is shipped'}")


def _sentence(text: str) -> str:
    """The first paragraph below the title of a card."""
    return " ".join(f"\n{text}".split("\n# ", 1)[1].split("\n\n")[1].split())
