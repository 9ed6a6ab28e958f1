"""The wire walker: what it sees turns with it, right steps cost nothing, it learns, is kept, says what it lacks."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.build import WALKER_SIZES, described_walker, rebuilt
from guide3d.dataset import Dataset, split
from guide3d.modeling.wire_walker import WireWalker
from guide3d.network_training import train_walker
from guide3d.picture_store import PictureStore
from guide3d.predictor import ShapePredictor
from guide3d.recipes import architecture_of, walk_recipe
from guide3d.shape_samples import clips_of, curve_of, walks_of
from guide3d.train import main
from guide3d.walk_samples import WalkObjective, carried_on, drifts
from tests.guide3d.drawn_data import draw


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def walker(form: str = "spherical") -> WireWalker:
    """A walker over the middle of a picture of 128 px, 1 px a mm."""
    torch.manual_seed(0)
    network = WireWalker(WALKER_SIZES["smoke"], form, positions=12, step_mm=1.7, source_px=128)
    network.intrinsics.copy_(torch.tensor([[1000.0, 0, 63.5], [0, 1000.0, 63.5], [0, 0, 1]]))
    network.start_mm.copy_(torch.tensor([0.0, 0, 1000]))
    return network


def objective_of(data: Dataset) -> WalkObjective:
    recipe, walks = walk_recipe("smoke"), walks_of(data, 1.7)
    preprocessing = dataclasses.replace(recipe.preprocessing, source_px=128)
    clips = clips_of(data, split(data).train, walks, 1, 1)
    store = PictureStore(data.frames, "a", preprocessing)
    return WalkObjective(store, clips, len(clips.frames), walks, data.camera_a)


def test_what_is_seen_turns_with_the_heading() -> None:
    network = walker()
    picture = torch.rand(128, 128, generator=torch.Generator().manual_seed(0)) * 200
    place = torch.tensor([[[8.0, -5.0, 1000.0]]])
    seen = network.look(network.levels(picture[None]), place, torch.tensor([[[1.0, 0, 0]]]))
    # a quarter turn in the image takes x to y and y to -x
    turned = torch.rot90(picture, -1, (0, 1))
    place, heading = torch.tensor([[[5.0, 8.0, 1000.0]]]), torch.tensor([[[0.0, 1, 0]]])
    again = network.look(network.levels(turned[None]), place, heading)
    glimpses = 2 * len(network.samples)
    assert torch.allclose(seen[..., :glimpses], again[..., :glimpses], atol=1e-3)
    assert seen[..., : len(network.samples)].std() > 0.05
    middle = int((network.samples.abs().sum(1) == 0).nonzero())
    # the middle of the glimpse is the pixel that the place projects to: (63.5 + 8, 63.5 - 5)
    around = torch.log1p(picture[58:60, 71:73]).mean()
    contrast = float(seen[0, 0, glimpses])  # by which the fine glimpse is divided, and a little more
    assert float(seen[0, 0, middle]) == pytest.approx(float(around) / (contrast + 0.03), abs=1e-4)


@pytest.mark.parametrize("form", ["spherical", "cartesian"])
def test_a_step_keeps_its_length_in_the_spherical_form_only(form: str) -> None:
    network = walker(form)
    for head in (network.step_head, network.stop_head):
        torch.nn.init.normal_(head[-1].weight)
    walked = network.walk(torch.zeros(2, 128, 128), 6)
    lengths = walked.places_mm.diff(dim=1).norm(dim=-1)
    assert walked.places_mm.shape == (2, 7, 3)
    assert bool(torch.allclose(lengths, torch.tensor(1.7), atol=1e-3)) == (form == "spherical")
    # the known walk told again says the same as walking did
    steps, stop = network(walked.seen, walked.headings)
    assert torch.allclose(steps, walked.steps_mm, atol=1e-4)
    assert torch.allclose(stop, walked.stop, atol=1e-4)
    curve = network.curves(torch.zeros(1, 1, 128, 128))[0]
    assert torch.allclose(curve[-1], network.start_mm, atol=1e-3)  # the tip comes first, the start last


def test_right_steps_cost_nothing_and_errors_are_led_back(data: Dataset) -> None:
    objective = objective_of(data)
    batch = objective.batch(objective.training_items[:3], None)
    points, last = batch["points"], batch["last"]
    steps = torch.cat((points.diff(dim=1), points[:, -1:] - points[:, -2:-1]), dim=1)
    headings = torch.nn.functional.normalize(steps, dim=-1)
    order = torch.arange(points.shape[1])
    arrived = torch.where(order >= last[:, None], 20.0, -20.0)
    left = ((points.gather(1, last[:, None, None].expand(-1, 1, 3)) - points) * headings).sum(-1) / 1.7
    stop = torch.stack((arrived, left), dim=-1)
    network = walker()
    assert float(objective.compared(network, points, headings, steps, stop, points, last).max()) < 1e-3
    wrong = objective.compared(network, points, headings, -steps, stop, points, last)
    assert float(wrong.min()) > 30.0  # ten times |2|^2
    # beside the wire, its own direction is no longer the right one
    beside = points + torch.tensor([0.0, 0.0, 2.0])
    assert float(objective.compared(network, beside, headings, steps, stop, points, last).min()) > 0.05


def test_errors_put_in_drift_slowly_and_come_from_the_generator() -> None:
    drift = drifts((4, 60, 3), (1.0, 1.0, 3.0), (0.97, 0.97, 0.99), np.random.default_rng(1))
    assert np.array_equal(drift, drifts((4, 60, 3), (1.0, 1.0, 3.0), (0.97, 0.97, 0.99), np.random.default_rng(1)))
    assert np.abs(np.diff(drift, axis=1)).mean() < 0.4 * np.abs(drift).mean()
    walk = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0]], np.float32)
    assert carried_on(walk, 5)[3:].tolist() == [[1, 4, 0], [1, 6, 0]]


@pytest.mark.parametrize("form", ["spherical", "cartesian"])
def test_it_learns_and_is_kept(data: Dataset, tmp_path: Path, form: str, caplog: pytest.LogCaptureFixture) -> None:
    recipe = walk_recipe("smoke")
    fit = dataclasses.replace(recipe.fit, epochs=12, batch_size=4, schedule="constant", learning_rate=3e-3)
    recipe = dataclasses.replace(recipe, fit=fit, own_walks=0.1)
    with caplog.at_level(logging.WARNING):
        predictor, report = train_walker(data, split(data), recipe, form, folder=tmp_path / "fit")
    assert report.rows[-1]["loss"] < 0.7 * report.rows[0]["loss"]
    assert "wires enter the image at places" in caplog.text  # the drawn ones do
    image = data.frames[0].image("a")
    curve = predictor.predict([image])
    assert np.linalg.norm(curve[-1] - curve_of(data.frames[0])[-1]) < 60
    predictor.save(tmp_path / "walker.pt")
    assert np.array_equal(ShapePredictor.load(tmp_path / "walker.pt").predict([image]), curve)


def test_what_a_file_tells_builds_it_again() -> None:
    network = walker("cartesian")
    again = rebuilt(described_walker(network))
    again.load_state_dict(network.state_dict())
    assert isinstance(again, WireWalker)
    assert again.form == "cartesian"


def test_wrong_requests_get_a_sentence(data: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert [architecture_of(size) for size in ("thesis", "desk", "smoke")] == ["vit", "walker", "walker"]
    with pytest.raises(ValueError, match="unknown form 'polar'; there are spherical, cartesian"):
        WireWalker(WALKER_SIZES["smoke"], "polar", positions=4, step_mm=1.0, source_px=128)
    with pytest.raises(ValueError, match="the wire walker comes as desk, smoke; 'thesis' is of the vision"):
        walk_recipe("thesis")
    words = [str(data.root), "--network", "spherical", "--size", "smoke", "--output", str(tmp_path)]
    with caplog.at_level(logging.ERROR):
        assert main([*words, "--architecture", "walker", "--pretrained", "weights.pt"]) == 2
    assert "the wire walker has no vision transformer that --pretrained fills" in caplog.text
