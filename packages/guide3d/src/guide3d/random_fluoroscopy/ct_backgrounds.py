"""Backgrounds from CT: a volume in Hounsfield units, projected along parallel rays, to attenuations of a body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2

WATER_PER_MM = 0.02  # linear attenuation at about 70 keV, 1/mm (NIST, XCOM)
_LEAST_HU = -1000.0
_RANGE = 1.2  # of the attenuations of a background: an exposure shows no more


def projected_ct(
    hounsfield: NDArray[np.floating], spacing_mm: tuple[float, float, float], angle_deg: float
) -> NDArray[np.float32]:
    """Projects a volume (slices, rows, columns) across its first axis.

    Args:
        hounsfield: values of air, -1000, to bone.
        spacing_mm: of slices, rows and columns.
        angle_deg: of the rays about the first axis; 0: along the rows' axis.

    Returns:
        (h, w) attenuation, the slices from top to bottom, one pixel a `spacing_mm` of the columns; the thinnest part is
        0, and the range at most 1.2.

    Raises:
        ValueError: an array that is no volume, or a spacing that is not above 0.
    """
    volume = np.asarray(hounsfield, np.float32)
    if volume.ndim != 3 or min(volume.shape) < 2:
        raise ValueError(f"expected a volume (slices, rows, columns), got an array of shape {volume.shape}")
    if not min(spacing_mm) > 0:
        raise ValueError(f"spacing_mm: expected three numbers above 0, got {spacing_mm}")
    between, down, across = spacing_mm
    rows, columns = round(volume.shape[1] * down / across), volume.shape[2]
    side = int(np.ceil(np.hypot(rows, columns)))
    turn = np.radians(angle_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shift = np.array([side, side]) / 2 - rotation @ np.array([columns, rows]) / 2
    matrix = np.column_stack((rotation, shift))
    lines = np.empty((len(volume), side), np.float32)
    for number, slice_hu in enumerate(volume):
        weight = WATER_PER_MM * np.maximum(slice_hu - _LEAST_HU, 0) / 1000
        weight = cv2.resize(weight, (columns, rows), interpolation=cv2.INTER_LINEAR)
        turned = cv2.warpAffine(weight, matrix, (side, side), flags=cv2.INTER_LINEAR)
        lines[number] = turned.sum(axis=0) * across
    height = max(2, round(len(volume) * between / across))
    image = np.asarray(cv2.resize(lines, (side, height), interpolation=cv2.INTER_CUBIC), np.float32)
    crossed = image.max(axis=0) > 0.2 * image.max()  # the rays beside the body are as good as white
    image = image[:, crossed] if crossed.sum() > 1 else image
    image -= np.percentile(image, 2)
    return np.clip(image * np.float32(min(1.0, _RANGE / max(float(np.percentile(image, 98)), 1e-6))), 0, 2 * _RANGE)
