"""The data set: annotations, images, cameras and true curves, read, split, planned and annotated.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split as Split
    from guide3d.dataset.acquisition_split import split_acquisitions as split_acquisitions
    from guide3d.dataset.dataset import VIEWS as VIEWS
    from guide3d.dataset.dataset import Dataset as Dataset
    from guide3d.dataset.dataset import images_of as images_of
    from guide3d.dataset.dataset import split as split
    from guide3d.dataset.frame import Frame as Frame
    from guide3d.image_file import ImageError as ImageError

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "acquisition_split": "Split split_acquisitions",
        "dataset": "Dataset VIEWS images_of split",
        "frame": "Frame ImageError",
    },
)
