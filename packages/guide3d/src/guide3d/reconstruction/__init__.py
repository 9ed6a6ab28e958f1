"""Reconstruction of wires: two annotated images and two cameras to a curve in space, with its uncertainty.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from guide3d.lazy_names import imported

if TYPE_CHECKING:
    from guide3d.reconstruction.reconstruction import (
        Reconstruction,
        ReconstructionSettings,
        reconstruct,
        reconstruct_greedy,
    )

_HOME = {
    "Reconstruction": "reconstruction",
    "ReconstructionSettings": "reconstruction",
    "reconstruct": "reconstruction",
    "reconstruct_greedy": "reconstruction",
}

__all__ = ["Reconstruction", "ReconstructionSettings", "reconstruct", "reconstruct_greedy"]


def __getattr__(name: str) -> Any:
    return imported(__name__, _HOME, name)
