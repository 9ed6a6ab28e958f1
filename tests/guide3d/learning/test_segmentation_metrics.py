"""Segmentation metrics: known values, their relations, empty masks, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.learning.evaluation import (
    centreline_dice,
    dice,
    foreground_iou,
    mean_iou,
    segmentation_metrics,
)


def bar(top: int, bottom: int, side: int = 40) -> np.ndarray:
    mask = np.zeros((side, side), np.uint8)
    mask[top:bottom, 4:36] = 255
    return mask


def test_known_values() -> None:
    true, predicted = bar(10, 14), bar(12, 16)  # half of each overlaps
    assert dice(predicted, true) == pytest.approx(0.5)
    assert foreground_iou(predicted, true) == pytest.approx(1 / 3)
    assert segmentation_metrics(predicted, true)["jaccard"] == pytest.approx(1 / 3)
    background = (1600 - 6 * 32) / (1600 - 2 * 32)
    assert mean_iou(predicted, true) == pytest.approx((1 / 3 + background) / 2)


def test_centreline_dice_forgives_width_but_not_gaps() -> None:
    true = bar(10, 16)
    thin = bar(12, 14)
    assert dice(thin, true) == pytest.approx(0.5)
    assert centreline_dice(thin, true) == 1.0
    broken = true.copy()
    broken[:, 15:25] = 0
    assert centreline_dice(broken, true) < 0.9
    assert centreline_dice(bar(30, 34), true) == 0.0


def test_figures_of_one_pair_belong_together() -> None:
    generator = np.random.default_rng(0)
    for _ in range(5):
        a, b = generator.random((2, 30, 30)) < 0.4
        told = segmentation_metrics(a, b)
        assert told["dice"] == pytest.approx(2 * told["jaccard"] / (1 + told["jaccard"]))
        assert told["jaccard"] == told["iou_foreground"]
        assert segmentation_metrics(b, a)["dice"] == told["dice"]


def test_empty_masks_agree_and_one_empty_mask_does_not() -> None:
    empty = np.zeros((8, 8), bool)
    assert set(segmentation_metrics(empty, empty).values()) == {1.0}
    assert segmentation_metrics(empty, ~empty)["dice"] == 0.0
    assert centreline_dice(empty, bar(1, 3, 40)[:8, :8]) == 0.0


def test_masks_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"same height and width, got shapes \(8, 8\) and \(9, 9\)"):
        dice(np.zeros((8, 8)), np.zeros((9, 9)))
