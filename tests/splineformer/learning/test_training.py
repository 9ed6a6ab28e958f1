"""Training: it goes on exactly where it was stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from guide3d.dataset.acquisition_split import Split
from guide3d.dataset.dataset import Dataset, split
from guide3d.learning.training import finished
from splineformer.build import VARIANTS
from splineformer.learning.recipes import recipe_of
from splineformer.learning.training import train
from splineformer.predictor import Predictor
from tests.guide3d.learning.drawn_data import draw


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_resumes_exactly(variant: str, data: Dataset, tmp_path: Path) -> None:
    parts = split(data, (0.6, 0.2, 0.2))
    assert isinstance(parts, Split)
    recipe = recipe_of(variant, "smoke")
    recipe = replace(recipe, fit=replace(recipe.fit, epochs=2), images=8)

    def trained(folder: Path, stop_after: int = 0) -> Predictor:
        def progress(now: object) -> None:
            if stop_after and now.epoch == stop_after:  # type: ignore[attr-defined]
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
