"""Guide3D: from two X-ray images to the shape of a guidewire in space, with plain arrays in and out.

World millimetres; pixels with (0, 0) in the centre of the top-left one; curves run tip first. `guide3d.read_pair` (from
images) and `guide3d.reconstruct` (from curves) are the usual ways in. Names are imported at first use, so that
`import guide3d` stays light; the geometry never needs torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from guide3d.lazy_names import imported

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from guide3d.geometry.bspline import BSplineCurve, fit_bspline
    from guide3d.geometry.camera import Camera, read_camera
    from guide3d.geometry.distortion import Distortion
    from guide3d.reading.image_reading import ImageReading, read
    from guide3d.reading.pair_reading import PairReading, read_pair
    from guide3d.reconstruction.reconstruction import (
        Reconstruction,
        ReconstructionSettings,
        reconstruct,
        reconstruct_greedy,
    )
    from guide3d.shipped import load, models

__version__ = "0.1.0"

_HOME = {
    "BSplineCurve": "geometry.bspline",
    "fit_bspline": "geometry.bspline",
    "Camera": "geometry.camera",
    "read_camera": "geometry.camera",
    "Dataset": "dataset.dataset",
    "Distortion": "geometry.distortion",
    "load": "shipped",
    "models": "shipped",
    "ImageReading": "reading.image_reading",
    "PairReading": "reading.pair_reading",
    "read": "reading.image_reading",
    "read_pair": "reading.pair_reading",
    "Reconstruction": "reconstruction.reconstruction",
    "ReconstructionSettings": "reconstruction.reconstruction",
    "reconstruct": "reconstruction.reconstruction",
    "reconstruct_greedy": "reconstruction.reconstruction",
}

__all__ = [
    "BSplineCurve",
    "Camera",
    "Dataset",
    "Distortion",
    "ImageReading",
    "PairReading",
    "Reconstruction",
    "ReconstructionSettings",
    "__version__",
    "fit_bspline",
    "load",
    "models",
    "read",
    "read_camera",
    "read_pair",
    "reconstruct",
    "reconstruct_greedy",
]


def __getattr__(name: str) -> Any:
    return imported(__name__, _HOME, name)
