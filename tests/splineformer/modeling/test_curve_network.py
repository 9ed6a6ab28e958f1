"""Parts of the networks: convolutions, decoder, refinement, published and ordered variants."""

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import arc_length, at_length
from splineformer.build import VARIANTS, from_spec, size_of, to_spec
from splineformer.learning.targets import course_of
from splineformer.modeling.ordered import OrderedSettings, OrderedSplineFormer
from splineformer.modeling.published import FIRST_END, SplineFormer, SplineFormerSettings
from splineformer.modeling.refinement import Refinement
from splineformer.modeling.transformer import Attention
from tests.splineformer.curves import levels, network, wavy_wire


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_batch_is_read(variant: str) -> None:
    model, images = network(variant), levels(3)
    read = model.read(images)
    assert model.variant == variant
    assert read.tokens.shape == (3, model.limit, 3)
    assert ((read.lengths >= 4) & (read.lengths <= model.limit)).all()
    side = round(read.features.shape[1] ** 0.5)
    assert read.features.shape == (3, side**2, model.settings.width)
    assert ((read.quality >= 0) & (read.quality <= 1)).all()
    assert read.kind.wires.shape == (3, 3)
    assert (read.error is None) == (variant == "published")
    assert not read.tokens.requires_grad
    again = model.read(images)
    assert all(torch.equal(a, b) for a, b in zip(read[:3], again[:3], strict=True))
    alone = model.read(images[1:2])
    assert torch.allclose(alone.tokens[0, : int(alone.lengths[0])], read.tokens[1, : int(read.lengths[1])], atol=1e-4)


def test_the_published_variant_sees_lines_whatever_shade_and_contrast() -> None:
    model = network("published")
    shade = torch.linspace(0, 60, 64).expand(1, 1, 64, 64)
    image = torch.full((1, 1, 64, 64), 150.0)
    image[..., 20, 5:50] = 110.0
    seen, fainter = model.normalised(image), model.normalised(0.4 * image + shade)
    assert (seen > 3.0).nonzero()[:, 2].unique().tolist() == [20]
    assert torch.allclose(fainter, seen, atol=0.5)
    assert model.normalised(shade).max() == 0.0


def test_a_published_network_that_read_grey_levels_is_refused() -> None:
    old = to_spec(network("published"))
    del old["settings"]["line_px"]
    with pytest.raises(ValueError, match=r"settings are of another version .*line_px"):
        from_spec(old)


def test_cache_gives_what_the_whole_sequence_gives() -> None:
    model = network("published")
    assert isinstance(model, SplineFormer)
    tokens, image = torch.rand(2, 9, 3), levels(2)
    memory = model.encoder(model.normalised(image))
    whole = model.decoder(tokens, memory)
    cache = model.decoder.begin(memory)
    steps = [model.decoder.step(tokens[:, k : k + 1], cache) for k in range(9)]
    assert torch.allclose(torch.cat([one.tokens for one in steps], 1), whole.tokens, atol=1e-5)
    assert torch.allclose(torch.cat([one.end for one in steps], 1), whole.end, atol=1e-5)


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


def test_what_lies_out_of_sight_does_not_move_a_point() -> None:
    torch.manual_seed(0)
    step = Refinement(1, 1 / 32, 2, 8)
    torch.nn.init.normal_(step.out.weight, std=0.1)
    points = torch.linspace(0.2, 0.4, 12)[None, :, None].expand(1, 12, 2)
    plain = torch.zeros(1, 1, 32, 32)
    far, near = plain.clone(), plain.clone()
    far[..., 24:, 24:] = 1.0
    near[..., 8:12, 8:12] = 1.0
    assert step.sight == pytest.approx(3 / 32)
    assert torch.equal(step(far, points)[0], step(plain, points)[0])
    assert not torch.equal(step(near, points)[0], step(plain, points)[0])


def test_attention_answers_with_the_weights_it_gives() -> None:
    torch.manual_seed(0)
    attention, x, source = Attention(8, 2), torch.rand(2, 3, 8), torch.rand(2, 5, 8)
    keys_values = attention.keys_values(source)
    weights = attention.weights(x, keys_values)
    assert weights.shape == (2, 2, 3, 5)
    assert torch.allclose(weights.sum(-1), torch.ones(2, 2, 3))
    answer = attention.out((weights @ keys_values[1]).transpose(1, 2).flatten(2))
    assert torch.allclose(answer, attention(x, keys_values), atol=1e-6)
    with pytest.raises(ValueError, match="heads must divide the width, got 3 and 8"):
        Attention(8, 3)


def test_ordered_variant() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    predicted = model(levels(3))
    s = model.settings
    assert predicted.control.shape == (3, s.control_points, 2)
    assert len(predicted.stages) == len(predicted.begun) == len(s.cells)
    assert torch.equal(predicted.stages[0], predicted.begun[0])  # a new refinement moves nothing
    assert torch.allclose(predicted.begun[0][:, 0], predicted.tip.place, atol=1e-6)  # the curve is led to its tip
    assert torch.allclose(predicted.begun[0][:, -1], predicted.overview[:, -1], atol=1e-6)
    assert predicted.kind.wires.shape == (3, 3)
    read = model.read(levels(3))
    assert torch.allclose(read.tokens[..., 1:], predicted.control, atol=1e-6)
    assert ((read.quality > 0) & (read.quality < 1)).all()
    with pytest.raises(ValueError, match="divisible by 32"):
        OrderedSplineFormer(OrderedSettings(image_px=250))


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


def test_reading_again_begins_with_the_given_curve() -> None:
    model = network("ordered")
    image = torch.full((1, 1, 64, 64), 200.0)
    line = torch.stack([torch.linspace(0.2, 0.8, 50), torch.full((50,), 0.4)], -1)[None]
    first, second = model.read(image), model.read_again(image, line)
    assert not torch.allclose(first.tokens, second.tokens)
    # an untrained network moves points nowhere but at the tip
    assert torch.allclose(second.tokens[0, -1, 1:], line[0, -1], atol=1e-3)
    assert network("published").read_again(image, line) is None


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


@pytest.mark.parametrize(("bias", "expected"), [(20.0, FIRST_END), (-20.0, 23)])
def test_where_the_sequence_ends(bias: float, expected: int) -> None:
    model = network("published")
    torch.nn.init.constant_(model.decoder.end.bias, bias)
    decoded = model.decode(levels(2))
    assert decoded.lengths.tolist() == [expected] * 2
    assert decoded.tokens.shape == (2, 23, 3)
    assert (decoded.tokens >= 0).all()
