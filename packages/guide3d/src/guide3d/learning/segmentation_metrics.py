"""Overlap of a predicted with a true mask: Dice, IoU of the wire and mean over both classes, Jaccard, centreline Dice.

With P the predicted and T the true pixels of the wire, and P', T' those of the background:

    Dice            = 2 |P ∩ T| / (|P| + |T|)
    IoU of the wire = |P ∩ T| / |P ∪ T|                              the Jaccard index is the same
    mean IoU        = (|P ∩ T| / |P ∪ T| + |P' ∩ T'| / |P' ∪ T'|) / 2
    centreline Dice = 2 p s / (p + s),  p = |S(P) ∩ T| / |S(P)|,  s = |S(T) ∩ P| / |S(T)|,  S: skeleton

So Dice = 2 J / (1 + J), and the mean IoU of a thin wire lies near (J + 1) / 2: a mean below J cannot come from the same
masks. Two empty masks agree: every figure is 1.

Source: centreline Dice from Shit et al., clDice, 2021.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def _pair(predicted: ArrayLike, true: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    a, b = np.asarray(predicted), np.asarray(true)
    if a.shape != b.shape or a.ndim != 2:
        raise ValueError(f"expected two masks of the same height and width, got shapes {a.shape} and {b.shape}")
    return a != 0, b != 0


def _ratio(part: np.integer | int | float, whole: np.integer | int | float) -> float:
    return float(part) / float(whole) if whole else 1.0


def dice(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the Dice coefficient, 0 to 1, of two (h, w) masks whose wire is not 0."""
    a, b = _pair(predicted, true)
    return _ratio(2 * np.count_nonzero(a & b), np.count_nonzero(a) + np.count_nonzero(b))


def foreground_iou(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the intersection over union of the wire, 0 to 1, of two (h, w) masks."""
    a, b = _pair(predicted, true)
    return _ratio(np.count_nonzero(a & b), np.count_nonzero(a | b))


def mean_iou(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the mean of the intersections over unions of wire and background, 0 to 1, of two (h, w) masks."""
    a, b = _pair(predicted, true)
    return (foreground_iou(a, b) + foreground_iou(~a, ~b)) / 2


def centreline_dice(predicted: ArrayLike, true: ArrayLike) -> float:
    """Returns the centreline Dice coefficient, 0 to 1, of two (h, w) masks."""
    from skimage.morphology import skeletonize

    a, b = _pair(predicted, true)
    if not a.any() or not b.any():
        return float(a.any() == b.any())
    line_a, line_b = skeletonize(a), skeletonize(b)
    precision = _ratio(np.count_nonzero(line_a & b), np.count_nonzero(line_a))
    sensitivity = _ratio(np.count_nonzero(line_b & a), np.count_nonzero(line_b))
    return _ratio(2 * precision * sensitivity, precision + sensitivity) if precision + sensitivity else 0.0


def segmentation_metrics(predicted: ArrayLike, true: ArrayLike) -> dict[str, float]:
    """Returns all of them by name: dice, iou_foreground, miou, jaccard and centreline_dice, 0 to 1."""
    return {
        "dice": dice(predicted, true),
        "iou_foreground": foreground_iou(predicted, true),
        "miou": mean_iou(predicted, true),
        "jaccard": foreground_iou(predicted, true),
        "centreline_dice": centreline_dice(predicted, true),
    }
