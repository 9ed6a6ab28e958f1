"""What is imported and how: an anatomy's files with the arguments of `import_anatomy`, and their hash."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cathsim.anatomy.mesh.surface_import import Names
from cathsim.guarded_reading import open_regular

FINEST, COARSEST = 5e-4, 2.5e-3  # m, resolutions


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
