"""Whether a data set's annotations and cameras belong together: swapped cameras, raw or undistorted annotations."""

from __future__ import annotations

import numpy as np

from guide3d.dataset.dataset import Dataset
from guide3d.reconstruction import view_checks
from guide3d.reconstruction.view_checks import Verdict

_PAIRS = 60  # whose epipolar residuals are asked, spread over the data set


def undistorted_or_raw(data: Dataset) -> Verdict | None:
    """Tells whether annotations are undistorted already or raw; None without cameras and maps of their distortion."""
    if data.camera_a is None or data.camera_b is None or data.distortions is None:
        return None
    a, b = data.distortions
    return view_checks.undistorted_or_raw(
        data.camera_a, data.camera_b, _pairs(data), a.undistort_points, b.undistort_points
    )


def swapped_cameras(data: Dataset, undistorted: bool | None) -> Verdict | None:
    """Tells whether the cameras are "as given" or "swapped"; None without cameras. `undistorted` None counts as yes."""
    if data.camera_a is None or data.camera_b is None:
        return None
    pairs = _pairs(data)
    if undistorted is False and data.distortions is not None:
        a, b = data.distortions
        pairs = [(a.undistort_points(one), b.undistort_points(other)) for one, other in pairs]
    return view_checks.swapped_cameras(data.camera_a, data.camera_b, pairs)


def _pairs(data: Dataset) -> list[tuple[np.ndarray, np.ndarray]]:
    chosen = np.unique(np.linspace(0, len(data) - 1, _PAIRS).astype(int))
    return [(data.frames[i].polyline("a"), data.frames[i].polyline("b")) for i in chosen]
