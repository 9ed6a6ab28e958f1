"""Networks: sizes, the key-value cache, every encoder layer in use, the parallel variant, attention maps, export."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splineformer.attention import attention_map, decoder_attention, fused
from splineformer.build import SIZES, VARIANTS, build, described, rebuilt, size_of
from splineformer.export import export_onnx, onnx_difference
from splineformer.modeling.ordered import OrderedSettings, OrderedSplineFormer
from splineformer.modeling.positions import grid_positions, sequence_positions
from splineformer.modeling.refinement import Refinement
from splineformer.modeling.splineformer import FIRST_END, SplineFormer, SplineFormerSettings
from splineformer.modeling.walker import Steps, Walker, at_shares_of_length, frames
from splineformer.steps import steps_along
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


def test_parallel_variant() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    said = model(levels(3, 64))
    s = model.settings
    assert said.control.shape == (3, s.control_points, 2)
    assert len(said.stages) == s.refinements + 1
    assert ((said.stages[0] >= 0) & (said.stages[0] <= 1)).all()  # means of cells lie in the image
    assert torch.equal(said.stages[1], said.stages[0])  # a new refinement moves nothing
    assert said.kind.wires.shape == (3, 3)
    with pytest.raises(ValueError, match="divisible by 16"):
        OrderedSplineFormer(OrderedSettings(image_px=250))


def test_control_points_give_back_points_of_a_spline() -> None:
    model = network("ordered", "desk")
    points = torch.from_numpy(wavy_wire(1, 1, 400)).float()
    along = (model.shares * 399).round().long()
    from splineformer.decoding import collocation

    control = model.to_control @ points[along]
    assert (collocation(model.knots, model.shares) @ control - points[along]).abs().max() < 2e-3


def test_refinement_turns_with_the_curve() -> None:
    torch.manual_seed(0)
    step = Refinement(2, 1 / 32, 2, 16)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    features = torch.rand(1, 2, 32, 32)
    points = torch.from_numpy(wavy_wire(0, 1, 12)).float()[None] * 0.6 + 0.2
    moved = step(features, points) - points
    turned = step(features.rot90(1, (2, 3)), torch.stack([points[..., 1], 1 - points[..., 0]], -1))
    there = torch.stack([points[..., 1], 1 - points[..., 0]], -1)
    assert torch.allclose(turned - there, torch.stack([moved[..., 1], -moved[..., 0]], -1), atol=1e-5)


def test_steps_lead_along_a_wire_to_its_tip() -> None:
    curve, cell = wavy_wire(2, 1, 400), 1 / 48
    places, directions, ways, ends = steps_along(curve, cell, np.random.default_rng(0))
    across = np.column_stack([-directions[:, 1], directions[:, 0]])
    goals = places + cell * (ways[:, :1] * directions + ways[:, 1:] * across)
    apart = np.linalg.norm(goals[:, None] - curve[None], axis=-1)
    assert apart.min(axis=1).max() < 0.2 * cell  # all goals lie on the wire
    assert np.allclose(goals[ends > 0], curve[0])
    assert 0 < ends.sum() < len(ends)
    nearest = np.linalg.norm(places[:, None] - curve[None], axis=-1).argmin(axis=1)
    assert (apart.argmin(axis=1) <= nearest + 8).all()  # onwards to the tip, never back


class Follower(Walker):
    """A walker that knows the wire instead of seeing it."""

    def __init__(self, curve: np.ndarray, cell: float) -> None:
        super().__init__(1, cell, 1, 4, 60)
        self.curve = torch.from_numpy(curve).float()

    def forward(self, features: torch.Tensor, places: torch.Tensor, directions: torch.Tensor) -> Steps:
        index = (self.curve[None] - places).norm(dim=-1).argmin(-1)
        ahead = self.curve[(index - 12).clamp_min(0)][:, None]
        way = (frames(directions) @ ((ahead - places) / self.cell)[..., None])[..., 0]
        return Steps(way, torch.where(index[:, None] <= 12, 9.0, -9.0))


def test_walk_ends_at_the_tip() -> None:
    curve = wavy_wire(1, 1, 400)
    walker = Follower(curve, 1 / 48)
    start = torch.from_numpy(curve[-1:]).float()
    walk = walker.walk(torch.zeros(1, 1, 4, 4), start, torch.tensor([[1.0, 0.0]]))
    assert walk.arrived.all()
    length = int(walk.lengths[0])
    assert 20 < length < 60
    assert torch.allclose(walk.points[0, length - 1], torch.from_numpy(curve[0]).float(), atol=1e-5)
    assert torch.equal(walk.points[0, length:], walk.points[0, length - 1 :][:-1])
    walker.most = 5
    short = walker.walk(torch.zeros(1, 1, 4, 4), start, torch.tensor([[1.0, 0.0]]))
    assert not short.arrived.any()
    assert short.lengths.tolist() == [2]  # the tip seemed equally unlikely at every step: the first counts


def test_points_at_shares_of_a_way() -> None:
    points = torch.tensor([[[0.0, 0.0], [0.3, 0.0], [0.3, 0.1], [0.3, 0.1], [0.3, 0.1]]])
    found = at_shares_of_length(points, torch.tensor([3]), torch.tensor([1.0, 0.0, 0.375, 0.875]))
    assert torch.allclose(found[0], torch.tensor([[0.3, 0.1], [0, 0], [0.15, 0], [0.3, 0.05]]), atol=1e-6)


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
    with pytest.raises(ValueError, match="layout 0, this version reads 1"):
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
    weights, lengths = decoder_attention(model, levels(2, 64))
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
