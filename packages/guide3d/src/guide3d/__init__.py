"""Guide3D: from two X-ray images to the shape of a guidewire in space, with plain arrays in and out.

World millimetres; pixels with (0, 0) in the centre of the top-left one; curves run tip first. `guide3d.read_pair` (from
images) and `guide3d.reconstruct` (from curves) are the usual ways in. Names are imported at first use, so that
`import guide3d` stays light; the geometry never needs torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset as Dataset
    from guide3d.geometry.bspline import BSplineCurve as BSplineCurve
    from guide3d.geometry.bspline import fit_bspline as fit_bspline
    from guide3d.geometry.camera import Camera as Camera
    from guide3d.geometry.camera import read_camera as read_camera
    from guide3d.geometry.distortion import Distortion as Distortion
    from guide3d.reading.image_reading import ImageReading as ImageReading
    from guide3d.reading.image_reading import read as read
    from guide3d.reading.pair_reading import PairReading as PairReading
    from guide3d.reading.pair_reading import read_pair as read_pair
    from guide3d.reconstruction.reconstruction import Reconstruction as Reconstruction
    from guide3d.reconstruction.reconstruction import reconstruct as reconstruct
    from guide3d.reconstruction.reconstruction import reconstruct_greedy as reconstruct_greedy
    from guide3d.shipped import load as load
    from guide3d.shipped import models as models

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "dataset.dataset": "Dataset",
        "geometry.bspline": "BSplineCurve fit_bspline",
        "geometry.camera": "Camera read_camera",
        "geometry.distortion": "Distortion",
        "reading.image_reading": "ImageReading read",
        "reading.pair_reading": "PairReading read_pair",
        "reconstruction.reconstruction": "Reconstruction reconstruct reconstruct_greedy",
        "shipped": "load models",
    },
)
