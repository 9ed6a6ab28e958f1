"""Trained networks: a data set, its split and a recipe to a predictor; everything resumable, on one process or many."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from guide3d.dataset.dataset import VIEWS, images_of, samples_of
from guide3d.geometry.polyline import Array
from guide3d.learning.build import build_shape_network, to_spec
from guide3d.learning.distributed import Ranks
from guide3d.learning.picture_store import PictureStore
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor, built
from guide3d.learning.recipes import FORMS, FGRNRecipe, SegmentationRecipe, ShapeRecipe
from guide3d.learning.segmentation_samples import SegmentationObjective
from guide3d.learning.shape_samples import CAMERA, Clips, ShapeObjective, clips_of, walks_of
from guide3d.learning.training import FitProgress, FitReport, Objective, fit
from guide3d.modeling.shape_network import FGRN
from guide3d.modeling.spherical import SphericalForm

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split
    from guide3d.dataset.dataset import Dataset

Recipe = ShapeRecipe | FGRNRecipe | SegmentationRecipe
Curves = Mapping[int, Array]
# network, objective, the predictor's class, its size and its metadata
_Prepared = tuple[torch.nn.Module, Objective, Any, dict[str, Any], dict[str, Any]]


def train_network(
    data: Dataset,
    split: Split,
    recipe: Recipe,
    form: str = "spherical",
    *,
    folder: Path,
    pictures: Path | None = None,
    pretrained: Path | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Callable[[FitProgress], None] | None = None,
) -> tuple[Any, FitReport]:
    """Trains the network of a recipe.

    Args:
        form: of the shape network's curves, "spherical" or "cartesian".
        pictures: folder that keeps prepared pictures; None: in memory.
        pretrained: weights of the shape network's vision transformer, if there are any.
        ranks: that train together; None: this process alone.

    Returns:
        The predictor (of the recipe's kind), and what its training was like.

    Raises:
        ValueError: an unknown form, images that are not square, or a data set without curves in space.
    """
    recipe = replace(recipe, preprocessing=replace(recipe.preprocessing, source_px=data.side_px))
    if isinstance(recipe, ShapeRecipe):
        prepared = _shape(data, split, recipe, form, pictures, pretrained, seed)
    elif isinstance(recipe, FGRNRecipe):
        prepared = _fgrn(data, split, recipe, pictures, seed)
    else:
        prepared = _segmenter(data, split, recipe, pictures, seed)
    network, objective, predictor, size, metadata = prepared
    report = fit(
        network,
        objective,
        recipe.fit,
        folder=folder,
        seed=seed,
        recipe=(recipe, form, samples_of(data, split)),
        ranks=ranks,
        progress=progress,
    )
    return predictor(network, size, recipe.preprocessing, {**metadata, "best_epoch": report.best_epoch}), report


def _shape(
    data: Dataset, split: Split, recipe: ShapeRecipe, form: str, pictures: Path | None, pretrained: Path | None,
    seed: int,
) -> _Prepared:  # fmt: skip
    if form not in FORMS:
        raise ValueError(f"unknown form '{form}'; there are {', '.join(FORMS)}")
    walks = walks_of(data, recipe.step_mm)
    clips, training = _clips(data, split, walks, recipe.size.frames, recipe.targets)
    learnt = [walks[index] for index in np.unique(clips.targets[:training])]
    positions = max(len(walk) for walk in learnt)
    spherical = None
    if form == "spherical":
        spherical = SphericalForm.fit(learnt, recipe.step_mm, cumulative=recipe.cumulative)
    objective = ShapeObjective(
        PictureStore(data.frames, CAMERA, recipe.preprocessing, pictures), clips, training, walks, positions,
        form=spherical, loss=recipe.loss, augmentation=recipe.augmentation,
        anchor=recipe.size.anchor,
    )  # fmt: skip
    torch.manual_seed(seed)
    network = build_shape_network(recipe.size, spherical, positions, pretrained=pretrained)
    _fill(network, objective.statistics())
    metadata = {"form": form, "training_frames": len(learnt), "best_epoch": 0, "step_mm": recipe.step_mm}
    return network, objective, ShapePredictor, to_spec(recipe.size, spherical, positions), metadata


def _fgrn(data: Dataset, split: Split, recipe: FGRNRecipe, pictures: Path | None, seed: int) -> _Prepared:
    walks = walks_of(data, recipe.spacing_mm, chords=False)
    clips, training = _clips(data, split, walks, 1, 1)
    points = max(len(walks[index]) for index in np.unique(clips.targets[:training]))
    objective = ShapeObjective(
        PictureStore(data.frames, CAMERA, recipe.preprocessing, pictures), clips, training, walks, points,
        augmentation=recipe.augmentation, spacing_mm=recipe.spacing_mm,
    )  # fmt: skip
    torch.manual_seed(seed)
    network = FGRN(points=points, **recipe.sizes)
    _fill(network, objective.statistics())
    metadata = {"training_frames": training, "best_epoch": 0, "spacing_mm": recipe.spacing_mm}
    return network, objective, FGRNPredictor, {"points": points, **recipe.sizes}, metadata


def _segmenter(data: Dataset, split: Split, recipe: SegmentationRecipe, pictures: Path | None, seed: int) -> _Prepared:
    stores = [PictureStore(data.frames, camera, recipe.preprocessing, pictures) for camera in VIEWS]
    training = images_of(data, split.train, recipe.images)
    objective = SegmentationObjective(
        stores, training, images_of(data, split.validation, recipe.validation_images), crop_px=recipe.crop_px,
        mask_px=recipe.mask_px, dice=recipe.dice, augmentation=recipe.augmentation,
    )  # fmt: skip
    size = {"name": recipe.network, "crop_px": recipe.crop_px, "sizes": recipe.sizes}
    torch.manual_seed(seed)
    network = built(size)
    multiple, side = int(list(network.children())[1].multiple_px), recipe.preprocessing.size_px  # type: ignore[arg-type]
    if recipe.crop_px > side or recipe.crop_px % multiple:
        raise ValueError(f"crop_px={recipe.crop_px}: expected a multiple of {multiple}, at most {side}")
    sample = training[:: max(1, len(training) // 32)]
    seen = objective.batch(sample, np.random.default_rng(seed))["pictures"]
    _fill(next(network.children()), {"pixel_mean": seen.mean(), "pixel_scale": seen.std().clamp(min=1.0)})
    metadata = {"mask_px": recipe.mask_px, "training_images": len(training), "best_epoch": 0}
    return network, objective, SegmentationPredictor, size, metadata


def _clips(data: Dataset, split: Split, walks: Curves, frames: int, targets: int) -> tuple[Clips, int]:
    learnt = clips_of(data, split.train, walks, frames, targets)
    held = clips_of(data, split.validation, walks, frames, targets)
    both = Clips(np.concatenate((learnt.frames, held.frames)), np.concatenate((learnt.targets, held.targets)))
    return both, len(learnt.frames)


def _fill(network: torch.nn.Module, values: Mapping[str, Any]) -> None:
    buffers = dict(network.named_buffers(recurse=False))
    for name, value in values.items():
        if name in buffers:
            buffers[name].copy_(value)
