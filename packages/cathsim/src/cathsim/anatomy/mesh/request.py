"""What imports of surfaces and of label volumes have in common: resolution, names of one's own, hash of the files."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cathsim.anatomy.mesh.surface_import import Names
from cathsim.guarded_reading import open_regular

FINEST, COARSEST = 5e-4, 2.5e-3  # m, resolutions
ONE_AT_A_TIME = threading.Lock()  # an import takes much memory


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


def hashable_names(names: Names) -> tuple | None:
    """Names of one's own as a tuple, of pairs where they are a mapping; None without any."""
    if not names:
        return None
    return tuple(names.items()) if isinstance(names, Mapping) else tuple(names)


def names_of(names: tuple | None) -> Names:
    """What `hashable_names` was given."""
    return dict(names) if names and isinstance(names[0], tuple) else names


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
