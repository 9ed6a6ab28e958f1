"""Training on random fluoroscopy: pools, samples, recipes, what resumes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from guide3d.dataset.acquisition_split import Split
from guide3d.dataset.dataset import split
from guide3d.learning.training import FitProgress, finished
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.build import VARIANTS, build, size_of
from splineformer.learning.augmentation import Augmentation
from splineformer.learning.fluoroscopy_pool import NONE, ONE, SEVERAL, FluoroscopyPool, curve_of, draw_pool
from splineformer.learning.fluoroscopy_samples import FluoroscopyObjective
from splineformer.learning.fluoroscopy_training import FluoroscopyRecipe, fluoroscopy_recipe, train_on_fluoroscopy
from splineformer.learning.recipes import recipe_of
from splineformer.learning.training import train
from splineformer.predictor import Predictor
from tests.guide3d.learning.drawn_data import draw

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
def test_batches_are_determined_by_the_generator(variant: str, drawn: float) -> None:
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
    pool = draw_pool(images, range(3, 63), picture, "quarters", tmp_path)
    drawn = len(calls)
    assert drawn == len(pool) <= 60
    assert pool.pictures.shape == (len(pool), 32, 32)
    again = draw_pool(images, range(3, 63), picture, "quarters", tmp_path)
    assert len(calls) == drawn
    for name in ("pictures", "curves", "wires"):
        assert np.array_equal(getattr(pool, name), getattr(again, name), equal_nan=name == "curves")
    assert set(pool.wires) == {NONE, ONE, SEVERAL}
    assert (np.isnan(pool.curves).all(axis=(1, 2)) == (pool.wires == NONE)).all()
    with pytest.raises(ValueError, match="another seed, source or settings"):
        draw_pool(RandomFluoroscopy(SMALL, seed=5), range(3, 63), picture, "quarters", tmp_path)
    file = next(tmp_path.glob("pool_*.npz"))
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(ValueError, match="is damaged"):
        draw_pool(images, range(3, 63), picture, "quarters", tmp_path)


def test_parts_of_which_nothing_is_kept_are_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    images = RandomFluoroscopy(SMALL, seed=4)
    monkeypatch.setattr("splineformer.learning.fluoroscopy_pool._PART", 1)
    few = draw_pool(images, range(3, 63), quarter, "quarters", tmp_path)
    again = draw_pool(images, range(3, 63), quarter, "quarters", tmp_path)
    assert 0 < len(few) == len(again) < 60
    left_out = next(k for k in range(3, 63) if _left_out(images, k))
    with pytest.raises(ValueError, match="none of 1 random images could be used: draw more"):
        draw_pool(images, range(left_out, left_out + 1), quarter, "quarters")


def _left_out(images: RandomFluoroscopy, index: int) -> bool:
    wires, curve = curve_of(images.image(index))
    return wires != NONE and curve is None


def tiny(variant: str, input: str = "maps") -> FluoroscopyRecipe:
    """The smoke recipe on as few images as there can be."""
    return replace(fluoroscopy_recipe(variant, "smoke", input), images=2, validation_images=2, samples=8)


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


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_resumes_exactly(variant: str, tmp_path: Path) -> None:
    def trained(**given: Any) -> Predictor:
        return train_on_fluoroscopy(tiny(variant), pictures=tmp_path / "pictures", seed=1, **given)[0]

    assert resumed(trained, tmp_path).input == "maps"


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_in_a_data_set_resumes_exactly(variant: str, tmp_path: Path) -> None:
    data = draw(tmp_path / "drawn")
    parts = split(data, (0.6, 0.2, 0.2))
    assert isinstance(parts, Split)
    recipe = recipe_of(variant, "smoke")
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
