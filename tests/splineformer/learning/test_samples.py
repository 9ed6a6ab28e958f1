"""Samples: drawn by a generator, augmented alike, targets of each variant."""

import numpy as np
import pytest
import torch

from guide3d.dataset.dataset import Dataset, images_of
from guide3d.geometry.polyline import arc_length, resample
from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import pixels_of_shares, shares_of_pixels
from splineformer.learning.augmentation import (
    Augmentation,
    moved,
    warped,
)
from splineformer.learning.losses import attention_loss
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective, curves_of, passes_of
from splineformer.learning.targets import TARGETS, OrderedTargets, PublishedTargets, disturbed
from splineformer.tokens import sampled
from tests.guide3d.learning.drawn_data import draw
from tests.splineformer.curves import image_of, wavy_wire


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def test_wires_that_turn_much_are_met_oftener() -> None:
    straight = np.linspace([0.9, 0.5], [0.0, 0.5], 200)
    around = np.linspace(0.0, 4 * np.pi, 600)  # twice, so 12.6 rad
    coil = 0.5 + np.column_stack([0.1 * np.cos(around) + 0.002 * around, 0.1 * np.sin(around)])
    assert passes_of(straight, 3.0) == 1
    assert passes_of(coil, 3.0) == passes_of(coil[::-1], 3.0) == 4
    assert passes_of(straight[:2], 3.0) == 1
    assert passes_of(coil, 0.0) == 1
    assert recipe_of("published", "thesis").augmentation.turn_a_pass == 0.0  # trained as published


@pytest.mark.parametrize("variant", VARIANTS)
def test_batches_are_determined_by_the_generator(variant: str, data: Dataset) -> None:
    network = build(size_of(variant, "smoke"))
    names = list(data.acquisitions)

    class Store:
        def __init__(self, camera: str) -> None:
            self.camera = camera

        def healthy(self, indices: np.ndarray) -> np.ndarray:
            return indices != 1

        def pictures(self, indices: np.ndarray) -> np.ndarray:
            return np.stack([data.frames[i].image(self.camera)[::2, ::2] for i in indices])

    curves = curves_of(data)
    objective = SplineObjective(
        [Store("a"), Store("b")], curves, images_of(data, names[:4]), images_of(data, names[4:]), network,
        augmentation=Augmentation(turn_a_pass=0.5),
    )  # fmt: skip
    known = images_of(data, names[:4])
    assert objective.training_items.tolist() == [i for i in known for _ in range(passes_of(np.asarray(curves[i]), 0.5))]
    assert len(objective.training_items) > len(known)
    items = objective.training_items[:6]
    one, two = (objective.batch(items, np.random.default_rng(3)) for _ in range(2))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not torch.equal(one["images"], objective.batch(items, np.random.default_rng(4))["images"])
    plain = objective.batch(items, None)
    assert (plain["wires"] == 1).all()
    loss = objective.loss(network, plain)
    loss.backward()
    assert torch.isfinite(loss)
    assert 1 in items  # the frame that cannot be read was replaced
    with pytest.raises(ValueError, match="training part is empty"):
        SplineObjective([Store("a"), Store("b")], curves, items[:0], items, network)


def test_image_and_curve_move_alike() -> None:
    points, side = wavy_wire(4, SIDE := 256), SIDE
    image = torch.from_numpy(image_of(points, seed=1)).float()[None, None]
    share = shares_of_pixels(points, (side, side))
    new, where = moved(share, Augmentation(shift=0.1, turn_deg=20, stretch=0.2), np.random.default_rng(5))
    assert not np.allclose(new[0], share[0], atol=0.01)
    picture = warped(image, where[None])[0, 0].numpy()
    column, row = pixels_of_shares(resample(new, count=60)[3:-6], (side, side)).round().astype(int).T
    assert np.median(picture[row, column]) < np.median(picture[np.clip(row + 9, 0, side - 1), column]) - 40


CURVES = [wavy_wire(seed, 1) for seed in range(3)]


def targets_of(variant: str) -> PublishedTargets | OrderedTargets:
    torch.manual_seed(0)
    network = build(size_of(variant, "smoke")).eval()
    made: PublishedTargets | OrderedTargets = TARGETS[variant](network, None)
    return made


def test_published_targets_are_tokens_in_network_units() -> None:
    targets = targets_of("published")(CURVES, None)
    assert targets["tokens"].shape == (3, 23, 3)
    assert targets["lengths"].tolist() == [23] * 3
    assert torch.equal(targets["given"][:, 0], targets["tokens"][:, 0])
    for tokens, curve in zip(targets["tokens"].double().numpy(), CURVES, strict=True):
        assert tokens[-4:, 0].tolist() == [1.0] * 4  # knots are shares of the length
        assert np.allclose(tokens[[0, -1], 1:], curve[[0, -1]], atol=1e-6)  # the first token's point is the tip
        assert np.abs(sampled(tokens, 50) - resample(curve, count=50)).max() < 2e-3


def test_the_tokens_of_a_wire_that_moves_move_with_it() -> None:
    targets, offset = targets_of("published"), np.array([0.003, -0.001])
    here, there = (targets([curve + by for curve in CURVES], None)["tokens"] for by in (0.0, offset))
    assert torch.allclose(there[..., 1:] - here[..., 1:], torch.tensor(offset, dtype=torch.float32), atol=1e-6)


def test_the_tokens_to_go_on_from_are_disturbed_but_for_the_tip() -> None:
    tokens = torch.zeros(400, 9, 3)
    given = disturbed(tokens, np.random.default_rng(0))
    assert torch.equal(given[:, 0], tokens[:, 0])
    spread = given[:, 1:].square().mean((1, 2)).sqrt()
    assert 0.0 < spread.min() < 0.05 < 0.2 < spread.max() < 0.7  # from hardly at all to more than the curve's reach
    common = given[:, 1:].mean(1)
    assert 0.4 < (common.square().mean() / given[:, 1:].square().mean()).item() < 0.75  # a half of it shifts a sequence


def test_ordered_targets_are_points_of_the_curve() -> None:
    made = targets_of("ordered")
    targets = made(CURVES, None)
    queries, steps = made.network.settings.queries, made.network.settings.steps
    assert targets["points"].shape == (3, queries, 2)
    assert targets["course"].shape == (3, steps, 2)
    for number, curve in enumerate(CURVES):
        assert np.allclose(targets["points"][number, [0, -1]], curve[[0, -1]], atol=1e-6)
        assert np.allclose(targets["curve"][number, [0, -1]], curve[[0, -1]], atol=1e-6)
        assert np.allclose(targets["course"][number, 0], curve[-1], atol=1e-6)  # it begins where the wire comes in
        assert targets["length"][number] == pytest.approx(arc_length(curve)[-1] / made.network.step, rel=1e-5)


def test_attention_loss_is_least_at_the_true_place() -> None:
    points = torch.tensor([[[0.30, 0.70]]])
    side = 8
    cells = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1)
    distance = (cells - (points[0] * side - 0.5)).norm(dim=1)
    right, wrong = -(distance**2), -((distance - 3) ** 2)
    assert attention_loss(right[None, None], points) < attention_loss(wrong[None, None], points)
    assert attention_loss(torch.zeros(1, 1, side**2), points).item() == pytest.approx(np.log(side**2), rel=1e-5)
