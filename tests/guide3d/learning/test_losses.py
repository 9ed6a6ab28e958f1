"""Losses, precisions and metrics of known values."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from guide3d.learning.evaluation import centreline_dice, dice, foreground_iou, mean_iou, segmentation_metrics
from guide3d.learning.losses import ShapeLoss, fgrn_loss
from guide3d.learning.precision import attention, bfloat16_on_processor
from guide3d.modeling.shape_network import PredictedShapes


def shapes(points: torch.Tensor, offsets: torch.Tensor, last: torch.Tensor) -> PredictedShapes:
    logits = torch.full(points.shape[:2], -40.0)
    logits[torch.arange(len(last)), last] = 40.0
    return PredictedShapes(points[:, 0], offsets, points, logits)


def test_shape_loss_weighs_its_parts_and_ignores_padding() -> None:
    torch.manual_seed(0)
    points, offsets, last = 10 * torch.randn(3, 6, 3), torch.randn(3, 5, 2), torch.tensor([5, 3, 2])
    right = shapes(points, offsets, last)
    loss = ShapeLoss(tip=1.0, offset=2.0, stop=1.0, curve=3.0)
    assert loss(right, points, offsets, last) == pytest.approx(0.0, abs=1e-4)
    padded = points.clone()
    padded[2, 3:] += 100.0
    told = offsets.clone()
    told[2, 2:] += 5.0
    assert loss(right, padded, told, last) == pytest.approx(0.0, abs=1e-4)
    turned = offsets.clone()
    turned[0, 0, 0] += 1.0  # one of five steps, of weight 2
    assert loss(right, points, turned, last)[0] == pytest.approx(2.0 / 5, abs=1e-4)
    moved = points + torch.tensor([10.0, 0, 0])  # 1 cm: tip 1, curve 3
    assert loss(right, moved, offsets, last) == pytest.approx(4.0, abs=1e-3)


def test_fgrn_loss_is_huber_and_spacing_in_metres() -> None:
    line = torch.zeros(1, 5, 3)
    line[0, :, 0] = 2.0 * torch.arange(5)
    last = torch.tensor([4])
    assert fgrn_loss(line, line, last)[0] == 0.0
    away = line + torch.tensor([0, 0, 30.0])  # 30 mm in one of three coordinates
    assert fgrn_loss(away, line, last)[0] == pytest.approx(1000 * 0.5 * 0.03**2 / 3)
    stretched = 1.5 * line  # 3 mm apart instead of 2
    expected = 1000 * 0.5 * np.square(0.001 * np.arange(5)).mean() / 3 + 0.001
    assert fgrn_loss(stretched, line, last)[0] == pytest.approx(expected, rel=1e-4)
    far = line.clone()
    far[0, 3:] += 99.0
    assert fgrn_loss(line, far, torch.tensor([2]))[0] == 0.0


@pytest.mark.parametrize(
    ("abilities", "expected"), [({"amx_bf16": True}, torch.bfloat16), ({"avx2": True}, torch.float32)]
)
def test_products_are_bfloat16_where_the_processor_has_it(
    monkeypatch: pytest.MonkeyPatch, abilities: dict[str, bool], expected: torch.dtype
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    layer = torch.nn.Conv2d(1, 4, 3)
    with bfloat16_on_processor():
        found = layer(torch.zeros(2, 1, 8, 8))
    assert found.dtype == expected
    found.float().sum().backward()
    assert layer.weight.dtype == layer.weight.grad.dtype == torch.float32
    assert layer(torch.zeros(2, 1, 8, 8)).dtype == torch.float32  # outside
    with bfloat16_on_processor(False):
        assert layer(torch.zeros(2, 1, 8, 8)).dtype == torch.float32


@pytest.mark.parametrize("causal", [False, True])
def test_attention_is_float32_under_bfloat16(monkeypatch: pytest.MonkeyPatch, causal: bool) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    torch.manual_seed(0)
    query, key, value = (torch.randn(2, 3, 5, 4) for _ in range(3))
    mask = None if causal else torch.randn(1, 3, 5, 5)
    expected = functional.scaled_dot_product_attention(query, key, value, mask, is_causal=causal)
    assert torch.equal(attention(query, key, value, mask, causal=causal), expected)
    with bfloat16_on_processor():
        assert torch.equal(attention(query, key, value, mask, causal=causal), expected)
        rounded = attention(*(x.bfloat16() for x in (query, key, value)), mask, causal=causal)
    assert rounded.dtype == torch.float32
    assert torch.allclose(rounded, expected, atol=0.05)


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
    empty = np.zeros((8, 8), bool)
    assert set(segmentation_metrics(empty, empty).values()) == {1.0}
    assert segmentation_metrics(empty, ~empty)["dice"] == 0.0
    assert centreline_dice(empty, bar(1, 3, 40)[:8, :8]) == 0.0
