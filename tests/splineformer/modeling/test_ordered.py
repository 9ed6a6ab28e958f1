"""The ordered network: its predictions, its course, where it starts, its control points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import arc_length, at_length
from splineformer.build import build, size_of
from splineformer.decoding import collocation
from splineformer.learning.targets import course_of
from splineformer.modeling.ordered import OrderedSettings, OrderedSplineFormer
from splineformer.modeling.published import SplineFormer
from tests.splineformer.curves import image_of, wavy_wire


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


def test_ordered_variant() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    predicted = model(levels(3, 64))
    s = model.settings
    assert predicted.control.shape == (3, s.control_points, 2)
    assert len(predicted.stages) == len(predicted.begun) == len(s.cells)
    assert torch.equal(predicted.stages[0], predicted.begun[0])  # a new refinement moves nothing
    assert torch.allclose(predicted.begun[0][:, 0], predicted.tip.place, atol=1e-6)  # the curve is led to its tip
    assert torch.allclose(predicted.begun[0][:, -1], predicted.overview[:, -1], atol=1e-6)
    assert predicted.kind.wires.shape == (3, 3)
    read = model.read(levels(3, 64))
    assert torch.allclose(read.tokens[..., 1:], predicted.control, atol=1e-6)
    assert ((read.quality > 0) & (read.quality < 1)).all()
    with pytest.raises(ValueError, match="divisible by 32"):
        OrderedSplineFormer(OrderedSettings(image_px=250))


def test_overview_starts_at_the_mean_curve() -> None:
    model = network("ordered")
    assert isinstance(model, OrderedSplineFormer)
    wire, s = wavy_wire(2, 1), model.settings
    mean = torch.from_numpy(course_of(wire, s.steps, model.step)).float()
    model.start_at(mean, float(arc_length(wire)[-1]) / model.step)
    predicted = model(levels(2, 64))
    assert (predicted.course - mean).abs().max() < 0.3
    assert (predicted.overview[0, [0, -1]] - torch.from_numpy(wire[[0, -1]]).float()).abs().max() < 0.3


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
    predicted = model(levels(2, 64), starts, torch.tensor([True, False]))
    plain = model(levels(2, 64))
    assert torch.allclose(predicted.begun[0][0, -1], starts[0, -1], atol=1e-6)
    assert torch.equal(predicted.begun[0][1], plain.begun[0][1])
    assert torch.equal(predicted.overview, plain.overview)
    first = model(levels(2, 64), starts[:1], torch.tensor([False]))
    assert torch.allclose(first.stages[-1], plain.stages[-1][:1], atol=1e-6)
    assert len(first.course) == len(first.kind.wires) == 2  # the second got an overview


def test_control_points_give_back_points_of_a_spline() -> None:
    model = network("ordered", "desk")
    points = torch.from_numpy(wavy_wire(1, 1, 400)).float()
    along = (model.shares * 399).round().long()
    control = model.to_control @ points[along]
    assert (collocation(model.knots, model.shares) @ control - points[along]).abs().max() < 2e-3


def test_reading_again_begins_with_the_given_curve() -> None:
    torch.manual_seed(0)
    network = build(size_of("ordered", "smoke")).eval()
    image = torch.full((1, 1, 64, 64), 200.0)
    line = torch.stack([torch.linspace(0.2, 0.8, 50), torch.full((50,), 0.4)], -1)[None]
    first, second = network.read(image), network.read_again(image, line)
    assert second is not None
    assert not torch.allclose(first.tokens, second.tokens)
    # an untrained network moves points nowhere but at the tip
    assert torch.allclose(second.tokens[0, -1, 1:], line[0, -1], atol=1e-3)
    assert build(size_of("published", "smoke")).read_again(image, line) is None
