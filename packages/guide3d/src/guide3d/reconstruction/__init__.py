"""Reconstruction of wires: two annotated images and two cameras to a curve in space, with its uncertainty.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from guide3d.reconstruction.reconstruction import Reconstruction as Reconstruction
    from guide3d.reconstruction.reconstruction import ReconstructionSettings as ReconstructionSettings
    from guide3d.reconstruction.reconstruction import reconstruct as reconstruct
    from guide3d.reconstruction.reconstruction import reconstruct_greedy as reconstruct_greedy

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "reconstruction": "Reconstruction ReconstructionSettings reconstruct reconstruct_greedy",
    },
)
