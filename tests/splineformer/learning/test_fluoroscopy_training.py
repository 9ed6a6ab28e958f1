"""Training on random fluoroscopy: recipes, exact resume, and weights to begin with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splineformer.build import VARIANTS, build
from splineformer.learning.fluoroscopy_training import FluoroscopyRecipe, fluoroscopy_recipe, train_on_fluoroscopy
from splineformer.predictor import Predictor


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


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_resumes_exactly(variant: str, tmp_path: Path) -> None:
    recipe = tiny(variant)

    def trained(folder: Path, stop_after: int = 0) -> Predictor:
        def progress(now: object) -> None:
            if stop_after and now.epoch == stop_after:  # type: ignore[attr-defined]
                raise KeyboardInterrupt

        pictures = tmp_path / "pictures"
        return train_on_fluoroscopy(recipe, folder=folder, pictures=pictures, seed=1, progress=progress)[0]

    whole = trained(tmp_path / "whole")
    assert whole.input == "maps"
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path / "parts", 1)
    resumed = trained(tmp_path / "parts")
    for a, b in zip(whole.network.state_dict().values(), resumed.network.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_training_begins_with_given_weights_and_reads_levels(tmp_path: Path) -> None:
    recipe = tiny("ordered", "levels")
    recipe = replace(recipe, fit=replace(recipe.fit, epochs=1, learning_rate=1e-9, weight_decay=0.0))
    torch.manual_seed(7)
    start = build(recipe.settings).state_dict()
    predictor, report = train_on_fluoroscopy(recipe, folder=tmp_path, start=start)
    assert predictor.input == "levels"
    assert len(report.rows) == 1
    torch.testing.assert_close(predictor.network.state_dict()["to_tokens.weight"], start["to_tokens.weight"])
