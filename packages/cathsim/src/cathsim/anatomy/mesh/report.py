"""What was found out about an imported mesh, and what was done to it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ImportReport:
    """The account of an import.

    Attributes:
        file: name of the file.
        unit: the file's unit: "m", "cm", "mm" or "inch".
        unit_reason: why it is taken to be that.
        faces: triangles in the file.
        kind: "closed lumen", "lumen in a closed wall", or "tunnel" (through a thick wall or an open surface).
        borders: openings of the surface that were closed to find the lumen.
        rotation: rows are the patient's left, posterior and superior axis in the file's frame.
        offset: m; a point p of the file lies at scale * rotation @ p + offset in the world.
        scale: m per unit of the file.
        axes_kept: whether the rotation only exchanges axes and their signs.
        automatic_names: name of each branch to the name that was found for it.
        way_length: m from the entry "descending" to each target along the centrelines.
        notes: what was left out, assumed or changed.
    """

    file: str
    unit: str
    unit_reason: str
    faces: int
    kind: str
    borders: int
    rotation: tuple[tuple[float, float, float], ...]
    offset: tuple[float, float, float]
    scale: float
    axes_kept: bool
    automatic_names: dict[str, str]
    way_length: dict[str, float]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """As a value that JSON can hold."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> ImportReport:
        """From what `to_json` gave, through JSON.

        Args:
            value: the fields.

        Returns:
            The report.
        """
        rotation = tuple((float(a), float(b), float(c)) for a, b, c in value["rotation"])
        x, y, z = value["offset"]
        return cls(**{**value, "rotation": rotation, "offset": (x, y, z), "notes": tuple(value["notes"])})
