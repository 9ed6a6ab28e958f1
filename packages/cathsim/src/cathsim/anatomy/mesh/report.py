"""What an import is asked for, and its account, or the reason why it was refused and a picture of what came."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.guarded_reading import open_regular
from cathsim.viewing.figure import new_figure, plain_text

logger = logging.getLogger(__name__)
FINEST, COARSEST = 5e-4, 2.5e-3  # m, resolutions
_MOST_POINTS = 20_000

Array = NDArray[np.float64]
Names = Mapping[str, str] | Sequence[str] | None


@dataclass(frozen=True)
class Request:
    """What is imported, and how; it can be hashed. Attributes without a word here are arguments of `import_anatomy`.

    Attributes:
        labels: pairs of a volume's label and its vessel.
        names: of the user's own: in order along the arch, or pairs with the automatic name first.
    """

    path: Path
    unit: str | None
    labels: tuple | None
    names: tuple | None
    transform: str | None
    extend: bool
    resolution: float

    @property
    def own_names(self) -> Names:
        """The names as the user gave them."""
        return dict(self.names) if self.names and isinstance(self.names[0], tuple) else self.names

    def to_json(self) -> dict[str, Any]:
        """The arguments of `import_anatomy`, the path as it is from everywhere."""
        return {**vars(self), "path": str(self.path.resolve())}


def check_resolution(resolution: float, kind: str) -> float:
    """The resolution (m) as a float.

    Args:
        kind: what is imported, for the error.

    Raises:
        ValueError: it is no number from `FINEST` to `COARSEST`.
    """
    if not (isinstance(resolution, int | float) and math.isfinite(resolution) and FINEST <= resolution <= COARSEST):
        raise ValueError(f"resolution must lie in [{FINEST:g}, {COARSEST:g}] m for a {kind}, got {resolution!r}.")
    return float(resolution)


def content_digest(settings: Mapping[str, Any], files: Iterable[Path], *, in_folder: bool) -> str:
    """Hash of settings and of the content of files, in a folder of their names, too."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(json.dumps(settings).encode())
    for one in files:
        digest.update(os.fsencode(one.name) if in_folder else b"")
        with open_regular(one) as file:
            while block := file.read(1 << 22):
                digest.update(block)
    return digest.hexdigest()


@dataclass(frozen=True)
class ImportReport:
    """The account of an import."""

    file: str  # name of the file
    unit: str  # the file's unit: "m", "cm", "mm" or "inch"
    unit_reason: str  # why it is taken to be that
    faces: int  # triangles in the file
    kind: (
        str  # "closed lumen", "lumen in a closed wall", "tunnel" (through a thick wall or an open surface), "labels..."
    )
    borders: int  # openings of the surface that were closed to find the lumen
    # rows are the patient's left, posterior and superior axis in the file's frame
    rotation: ArrayLike
    offset: ArrayLike  # (3,) m; a point p of the file lies at scale * rotation @ p + offset in the world
    scale: float  # m per unit of the file
    axes_kept: bool  # whether the rotation only exchanges axes and their signs
    automatic_names: dict[str, str]  # name of each branch to the name that was found for it
    way_length: dict[str, float]  # m from the entry "descending" to each target along the centrelines
    notes: tuple[str, ...]  # what was left out, assumed or changed
    # ml of every vessel of a label volume: of its voxels, and of its part of the lumen
    volumes_ml: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rotation, offset = np.asarray(self.rotation, float).tolist(), np.asarray(self.offset, float).tolist()
        plain: dict[str, Any] = {"rotation": tuple(map(tuple, rotation)), "offset": tuple(offset)}
        plain |= {"notes": tuple(self.notes), "volumes_ml": {name: (a, b) for name, (a, b) in self.volumes_ml.items()}}
        self.__dict__.update(plain)

    @property
    def from_labels(self) -> bool:
        """Whether the file is a label volume, which says itself where the patient's axes are."""
        return self.kind.startswith("labels")

    def to_json(self) -> dict[str, Any]:
        """As a value that JSON can hold."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> ImportReport:
        """From what `to_json` gave, through JSON."""
        return cls(**value)


class MeshRefusedError(ValueError):
    """A mesh that cannot become a phantom.

    Attributes:
        picture: PNG file that shows what came, or None where there is nothing to draw.
    """

    def __init__(self, reason: str, picture: Path | None = None) -> None:
        super().__init__(reason if picture is None else f"{reason.rstrip('.')}; see the picture {picture}.")
        self.reason = reason
        self.picture = picture

    def __reduce__(self) -> tuple[type[MeshRefusedError], tuple[str, Path | None]]:
        return MeshRefusedError, (self.reason, self.picture)


def draw_refusal(surface: Array, found: Array, reason: str, path: Path) -> Path | None:
    """Draws a refused surface from three sides along the file's axes, with whatever lumen was found in it.

    Args:
        surface: (n, 3) points on the surface, any unit.
        found: (m, 3) points inside the lumen, in the same unit; may be empty.

    Returns:
        The PNG file, or None where it cannot be drawn (no matplotlib, no disk space).
    """
    try:
        figure = new_figure(figsize=(12.0, 5.2), dpi=100, facecolor="white", layout="constrained")
    except ModuleNotFoundError as error:
        logger.warning("no picture of the refused mesh: %s", error)
        return None
    rng = np.random.default_rng(0)
    sample = surface[rng.permutation(len(surface))[:_MOST_POINTS]]
    inner = found[rng.permutation(len(found))[:_MOST_POINTS]]
    for panel, (across, up, depth) in zip(figure.subplots(1, 3), ((0, 2, 1), (1, 2, 0), (0, 1, 2)), strict=True):
        order = np.argsort(sample[:, depth])
        panel.scatter(*sample[order][:, [across, up]].T, c=sample[order][:, depth], s=0.4, cmap="Greys", alpha=0.5)
        if len(inner):
            panel.scatter(*inner[:, [across, up]].T, s=0.6, color="#cc4438", alpha=0.3, label="lumen found")
            panel.legend(loc="upper right", fontsize=8, markerscale=8)
        panel.set_xlabel("xyz"[across])
        panel.set_ylabel("xyz"[up])
        panel.set_aspect("equal")
    figure.suptitle(plain_text(reason), fontsize=10, wrap=True)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        logger.warning("no picture of the refused mesh: %s cannot be written (%s).", path, error)
        return None
    return path
