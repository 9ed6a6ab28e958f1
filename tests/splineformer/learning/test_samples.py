"""Samples of data sets and of random fluoroscopy, trainings on both, which resume, and the commands that train."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from guide3d.dataset.dataset import Dataset, images_of, split
from guide3d.geometry.polyline import arc_length, resample
from guide3d.learning.training import FitProgress, finished
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import pixels_of_shares, shares_of_pixels
from splineformer.learning.augmentation import Augmentation, moved, warped
from splineformer.learning.fluoroscopy_samples import (
    NONE,
    ONE,
    SEVERAL,
    FluoroscopyObjective,
    FluoroscopyPool,
    curve_of,
    draw_pool,
)
from splineformer.learning.fluoroscopy_training import fluoroscopy_recipe, train_on_fluoroscopy
from splineformer.learning.losses import attention_loss
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective, curves_of, passes_of
from splineformer.learning.targets import TARGETS, OrderedTargets, PublishedTargets, disturbed
from splineformer.learning.training import main as command
from splineformer.learning.training import train
from splineformer.predictor import Predictor
from splineformer.tokens import sampled
from splineformer.train_on_fluoroscopy import main
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
    points, side = wavy_wire(4), 256
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
    made: PublishedTargets | OrderedTargets = TARGETS[variant](network)
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


SIDE = 64
TURNED = Augmentation(
    shift=0.1, turn_deg=180.0, stretch=0.2, gain=0.0, offset=0.0, noise=0.0, hidden=0.0, inverted=0.0, empty=0.0,
    several=0.0,
)  # fmt: skip


def pool_of(count: int) -> FluoroscopyPool:
    """White pictures with a dark horizontal line from the middle to the right border; the last one is empty."""
    pictures = np.full((count, SIDE, SIDE), 255, np.uint8)
    pictures[:-1, 31:33, SIDE // 2 :] = 60
    curve = np.column_stack([np.linspace(0.5, 1.0, 240), np.full(240, 0.5)])
    curves = np.repeat(curve[None], count, 0)
    curves[-1] = np.nan
    wires = np.array([ONE] * (count - 1) + [NONE])
    return FluoroscopyPool(pictures, curves, wires)


def objective_of(variant: str, drawn: float) -> FluoroscopyObjective:
    torch.manual_seed(0)
    network = build(size_of(variant, "smoke"))
    return FluoroscopyObjective(
        pool_of(4), pool_of(3), network, samples=40, drawn=drawn, augmentation=TURNED, background=255
    )


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("drawn", [0.0, 0.5, 1.0])
def test_batches_of_random_fluoroscopy_are_determined_by_the_generator(variant: str, drawn: float) -> None:
    objective = objective_of(variant, drawn)
    one, two = (objective.batch(objective.training_items[:8], np.random.default_rng(1)) for _ in range(2))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert len(one["images"]) == 8
    assert torch.isfinite(objective.loss(build(size_of(variant, "smoke")), one))
    plain = objective.batch(objective.validation_items, None)
    assert plain["wires"].tolist() == [ONE, ONE, NONE]


def test_pictures_move_with_their_curves() -> None:
    objective = objective_of("ordered", 0.0)
    batch = objective.batch(objective.training_items[:32], np.random.default_rng(2))
    directions = []
    for image, points, wires in zip(batch["images"], batch["points"], batch["wires"], strict=True):
        assert float(image.max()) == 255.0  # what comes in is white
        if wires == ONE:
            column, row = np.clip(points.numpy() * SIDE, 0, SIDE - 1).astype(int).T
            assert np.median(image[0].numpy()[row, column]) < 160
            directions.append((points[-1] - points[0]).numpy())
    assert len(directions) > 10
    assert np.ptp(np.array(directions), axis=0).min() > 0.4  # every way


SMALL = FluoroscopySettings(image_px=128, clutter=1e-6, no_wire=0.3, two_devices=0.6)


def quarter(image: np.ndarray) -> np.ndarray:
    """Every fourth pixel."""
    return image[::4, ::4]


def test_kept_pictures_are_read_again(tmp_path: Path) -> None:
    calls: list[int] = []

    def picture(image: np.ndarray) -> np.ndarray:
        calls.append(len(image))
        return quarter(image)

    images = RandomFluoroscopy(SMALL, seed=4)
    pool = draw_pool(images, range(3, 33), picture, "quarters", tmp_path)
    drawn = len(calls)
    assert drawn == len(pool) <= 30
    assert pool.pictures.shape == (len(pool), 32, 32)
    again = draw_pool(images, range(3, 33), picture, "quarters", tmp_path)
    assert len(calls) == drawn
    for name in ("pictures", "curves", "wires"):
        assert np.array_equal(getattr(pool, name), getattr(again, name), equal_nan=name == "curves")
    assert set(pool.wires) == {NONE, ONE, SEVERAL}
    assert (np.isnan(pool.curves).all(axis=(1, 2)) == (pool.wires == NONE)).all()
    with pytest.raises(ValueError, match="another seed, source or settings"):
        draw_pool(RandomFluoroscopy(SMALL, seed=5), range(3, 33), picture, "quarters", tmp_path)
    file = next(tmp_path.glob("pool_*.npz"))
    whole = file.read_bytes()
    way = whole.rindex(b"PK\x01\x02") + 10  # of compression
    for damaged in (whole[:100], whole[:way] + b"c" + whole[way + 1 :]):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged"):
            draw_pool(images, range(3, 33), picture, "quarters", tmp_path)


def test_parts_of_which_nothing_is_kept_are_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    images = RandomFluoroscopy(SMALL, seed=4)
    monkeypatch.setattr("splineformer.learning.fluoroscopy_samples._PART", 1)
    few = draw_pool(images, range(3, 33), quarter, "quarters", tmp_path)
    again = draw_pool(images, range(3, 33), quarter, "quarters", tmp_path)
    assert 0 < len(few) == len(again) < 30
    curves = {k: curve_of(images.image(k)) for k in range(3, 33)}
    left_out = next(k for k, (wires, curve) in curves.items() if wires != NONE and curve is None)
    with pytest.raises(ValueError, match="none of 1 random images could be used"):
        draw_pool(images, range(left_out, left_out + 1), quarter, "quarters")


def test_recipes_agree_with_their_input() -> None:
    assert fluoroscopy_recipe("ordered", "desk").settings.floor > 1  # type: ignore[union-attr]
    assert fluoroscopy_recipe("ordered", "desk", "levels").drawn == 0.0
    with pytest.raises(ValueError, match="unknown input 'edges'; there are levels, maps"):
        replace(fluoroscopy_recipe("ordered", "desk"), input="edges")
    with pytest.raises(ValueError, match="expected drawn 0, got"):
        replace(fluoroscopy_recipe("ordered", "desk", "levels"), drawn=0.5)


def stopped(now: FitProgress) -> None:
    raise KeyboardInterrupt


def resumed(trained: Callable[..., Predictor], folder: Path) -> Predictor:
    """What a training leaves in one go; a training that was stopped after its first epoch has to leave the same."""
    whole = trained(folder=folder / "whole")
    with pytest.raises(KeyboardInterrupt):
        trained(folder=folder / "parts", progress=stopped)
    parts = trained(folder=folder / "parts")
    for a, b in zip(whole.network.state_dict().values(), parts.network.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    return whole


def test_training_resumes_exactly(tmp_path: Path) -> None:
    recipe = replace(fluoroscopy_recipe("ordered", "smoke"), images=2, validation_images=2, samples=8)

    def trained(**given: Any) -> Predictor:
        return train_on_fluoroscopy(recipe, pictures=tmp_path / "pictures", seed=1, **given)[0]

    assert resumed(trained, tmp_path).input == "maps"


def test_training_in_a_data_set_resumes_exactly(data: Dataset, tmp_path: Path) -> None:
    parts = split(data, (0.6, 0.2, 0.2))
    recipe = recipe_of("published", "smoke")
    recipe = replace(recipe, fit=replace(recipe.fit, epochs=2), images=8)

    def trained(**given: Any) -> Predictor:
        return train(data, parts, recipe, seed=1, **given)[0]

    whole = resumed(trained, tmp_path)
    finished(tmp_path / "parts")
    assert not list((tmp_path / "parts").glob("*"))
    assert whole(data.frames[0].image("a")).wires in ("none", "one", "several")


def test_nothing_to_learn_from() -> None:
    empty = FluoroscopyPool(np.zeros((0, SIDE, SIDE), np.uint8), np.zeros((0, 240, 2)), np.zeros(0, np.int64))
    network = build(size_of("ordered", "smoke"))
    with pytest.raises(ValueError, match="no image to learn from"):
        FluoroscopyObjective(empty, empty, network, samples=4, drawn=0.5, augmentation=TURNED, background=255)


FEW = '{"images": 2, "validation_images": 2, "samples": 8}'


def test_the_command_leaves_a_network_that_reads(tmp_path: Path) -> None:
    words = ["--size", "smoke", "--output", str(tmp_path), "--epochs", "1", "--test-images", "1", "--device", "cpu"]
    assert main([*words, "--settings", FEW]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["predictor.pt", "training.json"]
    table = json.loads((tmp_path / "training.json").read_text())
    assert table["recipe"]["input"] == "maps"
    assert len(table["rows"]) == 1
    assert table["test"]["images"] + table["test"]["empty"] <= 1
    predictor = Predictor.load(tmp_path / "predictor.pt")
    assert predictor.input == "maps"
    image = image_of(wavy_wire(0))
    prediction = predictor(image)
    assert prediction.wires in ("none", "one", "several")
    if prediction.tokens is not None:
        assert np.isfinite(prediction.points()).all()
    assert predictor.picture(image).pixels.shape == (64, 64)


@pytest.mark.parametrize(
    ("main", "words"),
    [
        (command, ("--epochs", "10000000000000")),
        (command, ("--calibration", "{none}")),
        (command, ("--output", "{file}")),
        (main, ("--epochs", "0", "--settings", FEW)),
        (main, ("--settings", '{{"sample": 3}}')),
        (main, ("--fluoroscopy", '{{"noise": -1}}')),
    ],
)
def test_commands_refuse_with_one_sentence(
    main: Callable[[list[str]], int],
    words: tuple[str, ...],
    data: Dataset,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (tmp_path / "file").write_text("no folder")
    given = [word if word is FEW else word.format(none=tmp_path / "none", file=tmp_path / "file") for word in words]
    source = [str(data.root), "--variant", "ordered"] if main is command else []
    with caplog.at_level("ERROR"):
        assert main([*source, "--size", "smoke", "--device", "cpu", "--output", str(tmp_path / "out"), *given]) == 2
    messages = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(messages) == 1
    assert "\n" not in messages[0]


def test_a_seed_below_0_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        command([str(tmp_path), "--variant", "ordered", "--output", str(tmp_path), "--seed=-1"])
