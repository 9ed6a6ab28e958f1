"""The tip in its heat map, and the curve that is led to it."""

from __future__ import annotations

import torch

from splineformer.modeling.refinement import TipMap, led_to


def test_tip_lies_in_the_best_cell_near_where_it_is_expected() -> None:
    tip = TipMap(3, 8, 16, 4).eval()
    torch.nn.init.zeros_(tip.out.weight)
    tip.out.bias.data = torch.tensor([0.0, 0.25, -0.5])
    expected = torch.tensor([[0.53, 0.22]])
    seen = tip(torch.rand(1, 3, 16, 16), torch.rand(1, 8, 2, 2), expected)
    assert int(seen.logits.argmax()) == 3 * 16 + 8  # row 3, column 8: all cells look alike, the nearest is taken
    assert torch.allclose(seen.place[0], torch.tensor([(8.5 + 0.25) / 16, (3.5 - 0.5) / 16]))


def test_curve_is_led_to_its_tip() -> None:
    points = torch.rand(2, 5, 2)
    tips = torch.rand(2, 2)
    led = led_to(points, tips)
    assert torch.allclose(led[:, 0], tips)
    assert torch.equal(led[:, -1], points[:, -1])
    assert torch.allclose(led[:, 2] - points[:, 2], 0.25 * (tips - points[:, 0]))
