"""Reconstruction of wires: two annotated images and two cameras to a curve in space, with its uncertainty.

Names are imported at first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
