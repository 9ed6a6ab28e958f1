"""The catheters that the page offers: those of the shelf by shape and size, and one's own of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cathsim.devices.device_file import is_file
from cathsim.devices.shelf import CATHETERS, SHAPES, catheter_file

NO_CATHETER = "none"  # on the command line
OWN = "own catheter"


@dataclass(frozen=True)
class Offer:
    """A catheter that can be chosen."""

    name: str  # of the choice
    shape: str  # as the operator reads it
    french: int | None  # size; None: that of one's own file
    source: str  # as `load_catheter` takes it

    def to_page(self) -> dict[str, Any]:
        """What the page needs; a page learns no paths."""
        return {"name": self.name, "shape": self.shape, "french": self.french}


def offered(first: str | None) -> tuple[Offer, ...]:
    """The shelf in every size; before it, the one to begin with where that is a file.

    Args:
        first: catheter to begin with, None for the bare wire.
    """
    names = {f"{shape}_{size}f": (shape, size) for shape in SHAPES for size in sorted(catheter_file(shape).sizes)}
    own = [Offer(OWN, Path(first).stem, None, first)] if first and is_file(first) else []
    return (*own, *(Offer(name, shape, size, name) for name, (shape, size) in names.items()))


def find_offer(offers: Sequence[Offer], name: str) -> Offer:
    """The catheter of a name; a shape without its size is that of the default size.

    Raises:
        ValueError: it is not offered.
    """
    known = CATHETERS.get(name)
    for offer in offers:
        if name in (offer.name, offer.source) or (known is not None and CATHETERS.get(offer.source) == known):
            return offer
    raise ValueError(f"unknown catheter '{name}'; there are {', '.join(offer.name for offer in offers)}")
