"""Networks: sizes, the key-value cache, every encoder layer in use, the ordered variant, attention maps, export."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import arc_length, at_length
from splineformer.attention import attention_map, fused
from splineformer.build import SIZES, VARIANTS, build, described, rebuilt, size_of
from splineformer.decoding import collocation
from splineformer.export import export_onnx, onnx_difference
from splineformer.learning.targets import course_of
from splineformer.modeling.convolutions import dark_lines, line_pyramid, local_contrast
from splineformer.modeling.ordered import OrderedSettings, OrderedSplineFormer
from splineformer.modeling.published import FIRST_END, SplineFormer, SplineFormerSettings
from splineformer.modeling.refinement import Refinement, at_equal_shares
from splineformer.modeling.tip_map import TipMap, led_to
from splineformer.modeling.transformer import grid_positions, sequence_positions
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


@pytest.mark.parametrize(("size", "layers", "width"), [("thesis", 6, 256), ("thesis_large", 10, 512)])
def test_published_sizes(size: str, layers: int, width: int) -> None:
    settings = size_of("published", size)
    assert isinstance(settings, SplineFormerSettings)
    assert (settings.image_px, settings.patch_px, settings.limit, settings.heads) == (1024, 32, 23, 8)
    assert (settings.encoder_layers, settings.decoder_layers, settings.width) == (layers, layers, width)
    with torch.device("meta"):
        model = SplineFormer(settings)
    assert model.encoder.positions.shape == (1024, width)
    # self-attention 4 d² + 4 d, feed-forward 8 d² + 5 d, two norms 4 d
    assert sum(p.numel() for p in model.encoder.layers.parameters()) == layers * (12 * width**2 + 13 * width)


def test_every_encoder_layer_is_used() -> None:
    torch.manual_seed(0)
    model = SplineFormer(SplineFormerSettings(64, 16, 32, 2, 3, 1, dropout=0.0))
    model.encoder(model.normalised(levels(2, 64))).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in model.encoder.layers.parameters() if p.ndim > 1)


def test_cache_gives_what_the_whole_sequence_gives() -> None:
    model = network("published")
    assert isinstance(model, SplineFormer)
    tokens, image = torch.rand(2, 9, 3), levels(2, 64)
    memory = model.encoder(model.normalised(image))
    whole = model.decoder(tokens, memory)
    cache = model.decoder.begin(memory)
    steps = [model.decoder.step(tokens[:, k : k + 1], cache) for k in range(9)]
    assert torch.allclose(torch.cat([one.tokens for one in steps], 1), whole.tokens, atol=1e-5)
    assert torch.allclose(torch.cat([one.end for one in steps], 1), whole.end, atol=1e-5)


def test_later_tokens_do_not_change_earlier_ones() -> None:
    model = network("published")
    image, tokens = levels(1, 64), torch.rand(1, 6, 3)
    other = tokens.clone()
    other[:, 4:] += 1
    with torch.no_grad():
        a, b = model(image, tokens).following.tokens, model(image, other).following.tokens
    assert torch.equal(a[:, :4], b[:, :4])
    assert not torch.equal(a[:, 4:], b[:, 4:])


@pytest.mark.parametrize(("bias", "expected"), [(20.0, FIRST_END), (-20.0, 23)])
def test_where_the_sequence_ends(bias: float, expected: int) -> None:
    model = network("published")
    torch.nn.init.constant_(model.decoder.end.bias, bias)
    decoded = model.decode(levels(2, 64))
    assert decoded.lengths.tolist() == [expected] * 2
    assert decoded.tokens.shape == (2, 23, 3)
    assert (decoded.tokens >= 0).all()


def test_tip_predictor_starts_where_it_is_told() -> None:
    model = network("published")
    torch.nn.init.zeros_(model.tip.out.weight)
    model.tip.start_at(torch.tensor([0.2, 0.4, 0.6]))
    assert torch.allclose(model.tip(torch.rand(1, 1, 64, 64)), torch.tensor([[0.2, 0.4, 0.6]]), atol=1e-4)


def test_ordered_variant() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    said = model(levels(3, 64))
    s = model.settings
    assert said.control.shape == (3, s.control_points, 2)
    assert len(said.stages) == len(said.begun) == len(s.cells)
    assert torch.equal(said.stages[0], said.begun[0])  # a new refinement moves nothing
    assert torch.allclose(said.begun[0][:, 0], said.tip.place, atol=1e-6)  # the curve is led to its tip
    assert torch.allclose(said.begun[0][:, -1], said.overview[:, -1], atol=1e-6)
    assert said.kind.wires.shape == (3, 3)
    read = model.read(levels(3, 64))
    assert torch.allclose(read.tokens[..., 1:], said.control, atol=1e-6)
    assert ((read.quality > 0) & (read.quality < 1)).all()
    with pytest.raises(ValueError, match="divisible by 32"):
        OrderedSplineFormer(OrderedSettings(image_px=250))


def test_overview_starts_at_the_mean_curve() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    wire, s = wavy_wire(2, 1), model.settings
    mean = torch.from_numpy(course_of(wire, s.steps, model.step)).float()
    model.start_at(mean, float(arc_length(wire)[-1]) / model.step)
    said = model(levels(2, 64))
    assert (said.course - mean).abs().max() < 0.3
    assert (said.overview[0, [0, -1]] - torch.from_numpy(wire[[0, -1]]).float()).abs().max() < 0.3


def test_course_up_to_the_length_is_the_wire() -> None:
    model = network("ordered", "desk")
    assert isinstance(model, OrderedSplineFormer)
    wire = wavy_wire(2, 1, 800)
    course = torch.from_numpy(course_of(wire, model.settings.steps, model.step)).float()[None]
    length = torch.tensor([arc_length(wire)[-1] / model.step], dtype=torch.float32)
    points = model._up_to_length(course, length)[0]
    true = torch.from_numpy(at_length(wire, model.shares.numpy() * arc_length(wire)[-1])).float()
    assert (points - true).norm(dim=-1).max() < 0.01
    assert torch.allclose(points[-1], true[-1], atol=1e-5)
    beyond = course_of(wire, 400, 0.01)[-1] - wire[0]  # straight on beyond the tip
    assert np.linalg.norm(beyond) == pytest.approx(399 * 0.01 - arc_length(wire)[-1], rel=1e-3)


def test_refinements_begin_where_they_are_told() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    starts = torch.from_numpy(wavy_wire(1, 1, model.settings.queries)).float().expand(2, -1, -1) + 0.01
    said = model(levels(2, 64), starts, torch.tensor([True, False]))
    plain = model(levels(2, 64))
    assert torch.allclose(said.begun[0][0, -1], starts[0, -1], atol=1e-6)
    assert torch.equal(said.begun[0][1], plain.begun[0][1])
    assert torch.equal(said.overview, plain.overview)
    first = model(levels(2, 64), starts[:1], torch.tensor([False]))
    assert torch.allclose(first.stages[-1], plain.stages[-1][:1], atol=1e-6)
    assert len(first.course) == len(first.kind.wires) == 2  # the second got an overview


def test_control_points_give_back_points_of_a_spline() -> None:
    model = network("ordered", "desk")
    points = torch.from_numpy(wavy_wire(1, 1, 400)).float()
    along = (model.shares * 399).round().long()
    control = model.to_control @ points[along]
    assert (collocation(model.knots, model.shares) @ control - points[along]).abs().max() < 2e-3


def test_refinement_turns_with_the_curve() -> None:
    torch.manual_seed(0)
    step = Refinement(2, 1 / 32, 2, 16)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    features = torch.rand(1, 2, 32, 32)
    points = torch.from_numpy(wavy_wire(0, 1, 12)).float()[None] * 0.6 + 0.2
    moved = step(features, points)[0] - points
    turned = step(features.rot90(1, (2, 3)), torch.stack([points[..., 1], 1 - points[..., 0]], -1))[0]
    there = torch.stack([points[..., 1], 1 - points[..., 0]], -1)
    assert torch.allclose(turned - there, torch.stack([moved[..., 1], -moved[..., 0]], -1), atol=1e-5)


def test_lines_are_told_from_edges() -> None:
    image = torch.full((1, 1, 64, 64), 120.0)
    image[..., 40:] = 60.0  # an edge
    image[0, 0, 30, :30] -= 20.0  # a line
    image[0, 0, :20, 10] += 20.0  # a bright one
    lines = dark_lines(image, 2)[0, 0]
    assert (lines[30, 3:28] > 1).all()
    lines[29:32] = 0
    assert lines[:, 5:].abs().max() < 0.1 * lines[30].max().clamp_min(1)
    # neither brightness nor contrast matters, as long as there is more than the floor
    assert torch.allclose(dark_lines(0.5 * image + 40, 2), dark_lines(image, 2), atol=1e-4)
    assert torch.allclose(local_contrast(0.5 * image + 40), local_contrast(image), atol=1e-4)


def test_pyramid_keeps_lines_on_its_way_down() -> None:
    image = levels(1, 64)
    pyramid = line_pyramid(image, 2, 3)
    assert [tuple(maps.shape) for maps in pyramid] == [(1, 2, 64, 64), (1, 2, 32, 32), (1, 2, 16, 16)]
    assert pyramid[2][:, 1].max() == pyramid[0][:, 1].max()
    assert torch.allclose(pyramid[2][:, 0].mean(), pyramid[0][:, 0].mean(), atol=1e-5)


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


def test_points_at_shares_of_the_length() -> None:
    points = torch.tensor([[[0.0, 0.0], [0.3, 0.0], [0.3, 0.1]], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.4]]])
    found = at_equal_shares(points, torch.tensor([0.0, 0.375, 0.875, 1.0]))
    assert torch.allclose(found[0], torch.tensor([[0.0, 0.0], [0.15, 0], [0.3, 0.05], [0.3, 0.1]]), atol=1e-6)
    assert torch.allclose(found[1], torch.tensor([[0.0, 0.0], [0, 0.15], [0, 0.35], [0, 0.4]]), atol=1e-6)


def test_positions() -> None:
    assert sequence_positions(5, 8).shape == (5, 8)
    grid = grid_positions(4, 16)
    assert grid.shape == (16, 16)
    assert len(torch.unique(grid, dim=0)) == 16
    with pytest.raises(ValueError, match="multiple of 4"):
        grid_positions(4, 6)


@pytest.mark.parametrize("variant", VARIANTS)
def test_described_and_rebuilt(variant: str) -> None:
    model = network(variant)
    again = rebuilt(described(model))
    assert again.settings == model.settings
    assert again.load_state_dict(model.state_dict())
    with pytest.raises(ValueError, match="layout 0, this version reads 2"):
        rebuilt(described(model) | {"layout": 0})
    with pytest.raises(ValueError, match="another version"):
        rebuilt(described(model) | {"settings": {"colour": 3}})


def test_unknown_variant_and_size() -> None:
    with pytest.raises(ValueError, match="published, ordered"):
        size_of("other", "desk")
    with pytest.raises(ValueError, match="thesis, desk, smoke"):
        size_of("ordered", "huge")
    assert set(SIZES) == set(VARIANTS)


def test_fusion_of_attention() -> None:
    weights = torch.zeros(2, 3, 16)
    weights[0, 1, 5], weights[1, 2, 9], weights[1, 0, 2] = 0.5, 0.02, 0.01
    fusion = fused(weights, 0.6)
    assert fusion.shape == (4, 4)
    assert fusion[1, 1] == 1  # each head counts by its own range
    assert fusion[2, 1] == 1
    assert fusion[0, 2] == 0  # half of the greatest is discarded
    assert fused(weights, 0.4)[0, 2] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="discard"):
        fused(weights, 1.0)
    with pytest.raises(ValueError, match="side²"):
        fused(torch.zeros(2, 3, 15))


@pytest.mark.parametrize("variant", VARIANTS)
def test_attention_map(variant: str) -> None:
    model = network(variant)
    weights, lengths = model.attention(levels(2, 64))
    assert torch.allclose(weights.sum(-1), torch.ones(weights.shape[:3]), atol=1e-5)
    assert (lengths <= weights.shape[2]).all()
    seen = attention_map(model, image_of(wavy_wire(0)))
    assert seen.shape == (256, 256)
    assert 0 <= seen.min() < seen.max() <= 1


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra splineformer[onnx] is not installed",
)
@pytest.mark.parametrize("variant", VARIANTS)
def test_onnx_agrees_with_torch(variant: str, tmp_path: Path) -> None:
    settings = size_of(variant, "smoke")
    # unrolled: every token is a part of the graph of its own
    model = build(replace(settings, limit=4) if isinstance(settings, SplineFormerSettings) else settings).eval()
    files = export_onnx(model, tmp_path / "model.onnx", batch=2)
    assert max(onnx_difference(model, tmp_path / "model.onnx", batch=2).values()) < 1e-3
    assert sorted(tmp_path.iterdir()) == sorted(files)
