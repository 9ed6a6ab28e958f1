"""Predictor: images of all kinds in, curves out; files of models; samples, losses and a short training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.dataset.acquisition_split import Split
from guide3d.dataset.dataset import Dataset, images_of, split
from guide3d.geometry.polyline import resample
from guide3d.learning.model_file import read_content, write_content
from guide3d.learning.training import finished
from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import picture_of, pixels_of_shares, shares_of_pixels
from splineformer.learning.augmentation import (
    Augmentation,
    inside,
    moved,
    perturbed,
    shadow,
    warped,
    without_wire,
)
from splineformer.learning.losses import attention_loss, nearest_on_curve, offset_loss
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective, curves_of, passes_of
from splineformer.learning.training import train
from splineformer.predictor import Predictor, tokens_px
from splineformer.tokens import sampled, tokens_of_polyline
from splineformer.train import main as command
from tests.damaged_files import refusals
from tests.guide3d.learning.drawn_data import draw
from tests.splineformer.curves import image_of, wavy_wire


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def untrained(variant: str) -> Predictor:
    torch.manual_seed(0)
    return Predictor(build(size_of(variant, "smoke")), source_px=256)


def saying(predictor: Predictor, wires: int = 1, inverted: bool = False) -> Predictor:
    """The predictor with a head that always says the same."""
    head = predictor.network.kind
    for layer in (head.wires, head.inverted):
        torch.nn.init.zeros_(layer.weight)
    head.wires.bias.data = 9.0 * torch.eye(3)[wires]
    torch.nn.init.constant_(head.inverted.bias, 9.0 if inverted else -9.0)
    return predictor


@pytest.mark.parametrize("variant", VARIANTS)
def test_prediction_is_a_curve_in_pixels(variant: str) -> None:
    predictor = saying(untrained(variant))
    image = image_of(wavy_wire(0))
    told = predictor(image)
    assert told.wires == "one"
    assert not told.warnings
    assert np.allclose(told.curve.at(0.0), told.tip_px)
    assert len(told.knots_px) == len(told.control_points_px) + 4
    points = told.points(50)
    assert points.shape == (50, 2)
    steps = np.linalg.norm(np.diff(told.curve.sample(2000), axis=0), axis=1).sum()
    assert told.knots_px[-1] == pytest.approx(steps, rel=0.02)  # knots are the way along the curve
    assert 0 <= told.confidence <= 1
    batch = predictor.batch([image, image_of(wavy_wire(1)), image])
    assert np.allclose(batch[0].tokens, told.tokens, atol=1e-3)
    assert np.allclose(batch[0].tokens, batch[2].tokens, atol=1e-3)


def test_no_wire_and_several_wires_are_said() -> None:
    image = image_of(wavy_wire(0))
    none = saying(untrained("ordered"), 0)(image)
    assert none.wires == "none"
    assert none.tokens is None
    assert "no wire" in none.warnings[0]
    with pytest.raises(ValueError, match="shows no wire"):
        none.points()
    several = saying(untrained("ordered"), 2)(image)
    assert several.tokens is not None
    assert several.confidence < 0.01
    assert "more than one wire" in several.warnings[0]


@pytest.mark.parametrize("variant", VARIANTS)
def test_inverted_images_are_turned_over(variant: str) -> None:
    image = image_of(wavy_wire(0, 64), 64)  # the network's own size: averaging would round
    plain, turned = saying(untrained(variant)), saying(untrained(variant), inverted=True)
    told = turned(255 - image)
    assert told.inverted
    assert "inverted" in told.warnings[-1]
    assert np.allclose(told.tokens, plain(image).tokens, atol=1e-3)


def test_other_sizes_and_depths() -> None:
    predictor = saying(untrained("ordered"))
    points = wavy_wire(0)
    image = image_of(points)
    deep = predictor(image.astype(np.uint16) * 200 + 1000)
    assert "uint16" in deep.warnings[0]
    twice = predictor(image.repeat(2, 0).repeat(2, 1))
    assert "512 x 512 px instead of 256 x 256" in twice.warnings[0]
    assert np.allclose(twice.tip_px + 0.5, 2 * (predictor(image).tip_px + 0.5), atol=0.1)
    assert np.allclose(predictor(np.stack([image] * 3, -1)).tokens, predictor(image).tokens)
    wide = picture_of(image[:128], 64, 256)
    assert wide.side_px == 256
    assert not wide.pixels[40:].any()


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4, 7)), "expected a grey image"),
        (np.zeros((20, 20), np.uint8), "at least 64 px"),
        (np.full((100, 100), 7, np.uint8), "one grey level"),
        (np.full((100, 100), np.nan), "finite"),
        (np.arange(30000, dtype=np.uint16).reshape(100, 100, 3), "coloured"),
    ],
)
def test_what_is_no_image(image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        untrained("ordered")(image)
    with pytest.raises(ValueError, match="image 1: "):
        untrained("ordered").batch([image_of(wavy_wire(0)), image])


@pytest.mark.parametrize("variant", VARIANTS)
def test_file_of_a_model(variant: str, tmp_path: Path) -> None:
    predictor = saying(untrained(variant))
    predictor.save(tmp_path / "model.pt", epochs=3)
    again = Predictor.load(tmp_path / "model.pt")
    assert again.source_px == 256
    image = image_of(wavy_wire(2))
    assert np.array_equal(again(image).tokens, predictor(image).tokens)


def test_files_of_other_versions(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    with pytest.raises(FileNotFoundError, match="train one first"):
        Predictor.load(path)
    path.write_bytes(b"not a network")
    with pytest.raises(ValueError, match="damaged or no network"):
        Predictor.load(path)
    untrained("ordered").save(path)
    content = read_content(path)
    for change, message in (
        ({"format": "guide3d-network-0"}, "no network of format"),
        ({"kind": "shape"}, "kind shape, expected splineformer"),
        ({"network": content["network"] | {"layout": 7}}, "layout 7, this version reads 2"),
        ({"weights": {}}, "cannot be used"),
    ):
        write_content(path, content | change)
        with pytest.raises(ValueError, match=message):
            Predictor.load(path)


def test_graph_for_the_compiler_agrees() -> None:
    image = image_of(wavy_wire(0))
    plain = saying(untrained("ordered"))
    # the machine code is checked by benchmarks/splineformer/reading.py: making it takes too long here
    calls: list[int] = []

    def backend(graph: torch.fx.GraphModule, given: object) -> object:
        calls.append(len(graph.graph.nodes))
        return graph.forward

    compiled = Predictor(plain.network, source_px=256, compiled=True, backend=backend)
    assert np.allclose(compiled(image).tokens, plain(image).tokens, atol=1e-3)
    assert calls  # the compiler was asked
    before = len(calls)
    plain(image)
    assert len(calls) == before  # and only for the compiled predictor


def test_shares_and_pixels() -> None:
    shares = shares_of_pixels(np.array([[-0.5, 255.5], [127.5, 0.0]]), (256, 256))
    assert np.allclose(shares, [[0, 1], [0.5, 0.5 / 256]])
    assert np.allclose(pixels_of_shares(shares, (256, 256)), [[-0.5, 255.5], [127.5, 0.0]])


def test_tokens_in_pixels_trace_the_same_curve() -> None:
    points = wavy_wire(3, 1024)
    tokens = tokens_of_polyline(points)
    shares = tokens.copy()
    shares[:, 0] /= shares[-1, 0]
    shares[:, 1:] = shares_of_pixels(tokens[:, 1:], (1024, 1024))
    assert np.abs(sampled(tokens_px(shares, 1024.0), 60) - sampled(tokens, 60)).max() < 0.1


def test_part_inside_the_image() -> None:
    line = np.column_stack([np.linspace(0.5, 1.5, 11), np.full(11, 0.2)])
    kept = inside(line)
    assert np.allclose(kept[-1], [1.0, 0.2])
    assert inside(line[::-1]) is None  # the tip is outside
    assert inside(np.array([[0.5, 0.5], [0.501, 0.5]])) is None


def test_image_and_curve_move_alike() -> None:
    points, side = wavy_wire(4, SIDE := 256), SIDE
    image = torch.from_numpy(image_of(points, seed=1)).float()[None, None]
    share = shares_of_pixels(points, (side, side))
    new, where = moved(share, Augmentation(shift=0.1, turn_deg=20, stretch=0.2), np.random.default_rng(5))
    assert not np.allclose(new[0], share[0], atol=0.01)
    picture = warped(image, where[None])[0, 0].numpy()
    column, row = pixels_of_shares(resample(new, count=60)[3:-6], (side, side)).round().astype(int).T
    assert np.median(picture[row, column]) < np.median(picture[np.clip(row + 9, 0, side - 1), column]) - 40


def test_wire_is_taken_away() -> None:
    points = wavy_wire(4)
    image = torch.from_numpy(image_of(points)).float()[None]
    share = shares_of_pixels(points, (256, 256))
    empty = without_wire(image, share, np.random.default_rng(0))
    column, row = points.round().astype(int).T
    assert (empty[0, row, column] - image[0, row, column]).median() > 50
    assert (empty - image)[0, :20].abs().max() == 0  # elsewhere nothing changes
    assert shadow(image, empty)[0, row, column].median() < 0.7


def test_attention_loss_is_least_at_the_true_place() -> None:
    points = torch.tensor([[[0.30, 0.70]]])
    side = 8
    cells = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1)
    distance = (cells - (points[0] * side - 0.5)).norm(dim=1)
    right, wrong = -(distance**2), -((distance - 3) ** 2)
    assert attention_loss(right[None, None], points) < attention_loss(wrong[None, None], points)
    assert attention_loss(torch.zeros(1, 1, side**2), points).item() == pytest.approx(np.log(side**2), rel=1e-5)


def test_nearest_places_on_a_curve() -> None:
    curve = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]])
    points = torch.tensor([[[0.3, 0.2], [2.0, 0.4], [-1.0, -1.0]]])
    assert torch.allclose(nearest_on_curve(points, curve), torch.tensor([[[0.3, 0.0], [1.0, 0.4], [0.0, 0.0]]]))


def test_nearest_places_on_the_own_strand() -> None:
    # there and back: the strand beside is nearer, but belongs to another part of the length
    there = torch.stack([torch.linspace(0, 1, 21), torch.zeros(21)], -1)
    back = torch.stack([torch.linspace(1, 0, 21), torch.full((21,), 0.1)], -1)
    curve = torch.cat([there, back])[None]
    point = torch.tensor([[[0.4, 0.08]]])
    assert torch.allclose(nearest_on_curve(point, curve)[0, 0], torch.tensor([0.4, 0.1]), atol=1e-6)
    own = nearest_on_curve(point, curve, torch.tensor([0.2]), 0.1)[0, 0]
    assert torch.allclose(own, torch.tensor([0.4, 0.0]), atol=1e-6)


def test_offsets_are_right_where_they_point_to_the_place() -> None:
    side, point = 4, torch.tensor([[0.30, 0.70]])
    centres = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1) + 0.5
    right = (point * side - centres)[None]
    assert offset_loss(right, point).item() == pytest.approx(0, abs=1e-3)
    # half a cell is 12.5 hundredths of the side
    assert offset_loss(right + torch.tensor([0.5, 0.0]), point).item() == pytest.approx(12.5, rel=0.02)


def test_perturbation_is_smooth_and_of_different_size() -> None:
    points = torch.from_numpy(np.stack([wavy_wire(k, 1, 48) for k in range(12)])).float()
    moved = perturbed(points, np.random.default_rng(2)) - points
    size = moved.norm(dim=-1).mean(1)
    assert size.max() > 3 * size.min() > 0
    bend = (moved[:, 2:] + moved[:, :-2] - 2 * moved[:, 1:-1]).norm(dim=-1).mean(1)
    assert (bend < 0.3 * size).all()
    assert torch.equal(moved, perturbed(points, np.random.default_rng(2)) - points)


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
        augmentation=Augmentation(turn_a_pass=0.5), source_px=128,
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


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_resumes_exactly(variant: str, data: Dataset, tmp_path: Path) -> None:
    parts = split(data, (0.6, 0.2, 0.2))
    assert isinstance(parts, Split)
    recipe = recipe_of(variant, "smoke")
    recipe = replace(recipe, fit=replace(recipe.fit, epochs=2), images=8)

    def trained(folder: Path, stop_after: int = 0) -> Predictor:
        def progress(told: object) -> None:
            if stop_after and told.epoch == stop_after:  # type: ignore[attr-defined]
                raise KeyboardInterrupt

        return train(data, parts, recipe, folder=folder, seed=1, progress=progress)[0]

    whole = trained(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path / "parts", 1)
    resumed = trained(tmp_path / "parts")
    for a, b in zip(whole.network.state_dict().values(), resumed.network.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    finished(tmp_path / "parts")
    assert not list((tmp_path / "parts").glob("*"))
    assert whole(data.frames[0].image("a")).wires in ("none", "one", "several")


def test_a_wrong_bit_is_refused(tmp_path: Path) -> None:
    untrained("ordered").save(tmp_path / "model.pt")
    messages = refusals(tmp_path / "model.pt", lambda: Predictor.load(tmp_path / "model.pt"))
    assert all("model.pt is damaged or no network" in message for message in messages)


@pytest.mark.parametrize(
    "more", [("--epochs", "0"), ("--epochs", "10000000000000"), ("--calibration", "{none}"), ("--output", "{file}")]
)
def test_command_refuses_with_one_sentence(
    more: tuple[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    draw(tmp_path)
    (tmp_path / "file").write_text("no folder")
    words = [str(tmp_path), "--variant", "ordered", "--size", "smoke", "--device", "cpu", "--output", str(tmp_path)]
    given = [word.format(none=tmp_path / "none", file=tmp_path / "file") for word in more]
    with caplog.at_level("ERROR"):
        assert command([*words, *given]) == 2
    said = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(said) == 1
    assert "\n" not in said[0]
    with pytest.raises(SystemExit):
        command([*words, "--seed=-1"])
