"""The data set: annotations, images, cameras and true curves, read, split, planned and annotated.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from guide3d.lazy_names import imported

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split, split_acquisitions
    from guide3d.dataset.dataset import VIEWS, Dataset, images_of, split
    from guide3d.dataset.frame import Frame
    from guide3d.image_file import ImageError

_HOME = {
    "VIEWS": "dataset",
    "Dataset": "dataset",
    "Frame": "frame",
    "ImageError": "frame",
    "Split": "acquisition_split",
    "images_of": "dataset",
    "split": "dataset",
    "split_acquisitions": "acquisition_split",
}

__all__ = ["VIEWS", "Dataset", "Frame", "ImageError", "Split", "images_of", "split", "split_acquisitions"]


def __getattr__(name: str) -> Any:
    return imported(__name__, _HOME, name)
