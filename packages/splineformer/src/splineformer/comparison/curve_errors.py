"""Errors of a curve in an image, tip first, in pixels.

With a(s), b(s) the points of the predicted and the true curve at the share s of their lengths, s = 0, 1/99, ... 1:

    tip     = |a(0) - b(0)|
    mean    = mean_s |a(s) - b(s)|      a curve that is traced in the wrong order, or ends too early, is far off
    max     = max_s |a(s) - b(s)|
    chamfer = (mean_i min_j |a_i - b_j| + mean_j min_i |a_i - b_j|) / 2      order and ends do not matter
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from guide3d.geometry.polyline import checked, resample

SAMPLES = 100


def curve_errors(predicted_px: ArrayLike, true_px: ArrayLike) -> dict[str, float]:
    """Compares two curves: tip_px, mean_px, max_px and chamfer_px.

    Args:
        predicted_px, true_px: (n, 2) and (m, 2) points, tip first.

    Raises:
        ValueError: a curve of fewer than two different points.
    """
    a = resample(checked(predicted_px, 2, "predicted curve"), count=SAMPLES)
    b = resample(checked(true_px, 2, "true curve"), count=SAMPLES)
    along = np.linalg.norm(a - b, axis=1)
    apart = cdist(a, b)
    return {
        "tip_px": float(along[0]),
        "mean_px": float(along.mean()),
        "max_px": float(along.max()),
        "chamfer_px": float((apart.min(axis=1).mean() + apart.min(axis=0).mean()) / 2),
    }
