"""Trained networks: a data set, its split and a recipe to a predictor; everything resumable, on one process or many."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from guide3d.dataset.dataset import VIEWS, images_of
from guide3d.geometry.polyline import Array
from guide3d.learning.build import build_fgrn, build_shape_network
from guide3d.learning.distributed import Ranks
from guide3d.learning.picture_store import PictureStore
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor, built
from guide3d.learning.preprocessing import Preprocessing
from guide3d.learning.recipes import FORMS, FGRNRecipe, SegmentationRecipe, ShapeRecipe
from guide3d.learning.segmentation_samples import SegmentationObjective
from guide3d.learning.shape_samples import CAMERA, Clips, ShapeObjective, clips_of, walks_of
from guide3d.learning.training import FitProgress, FitReport, fit
from guide3d.modeling.spherical import SphericalForm

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split
    from guide3d.dataset.dataset import Dataset

Progress = Callable[[FitProgress], None]
Curves = Mapping[int, Array]


def train_shape(
    data: Dataset,
    split: Split,
    recipe: ShapeRecipe,
    form: str,
    *,
    folder: Path,
    pictures: Path | None = None,
    pretrained: Path | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Progress | None = None,
) -> tuple[ShapePredictor, FitReport]:
    """Trains the shape network.

    Args:
        data: the data set.
        split: of its acquisitions.
        recipe: of network and training.
        form: "spherical" or "cartesian".
        folder: of the checkpoints.
        pictures: folder that keeps prepared pictures; None: in memory.
        pretrained: weights of the vision transformer, if there are any.
        seed: of weights, shuffling and augmentation.
        ranks: that train together.
        progress: called after every epoch.

    Returns:
        The predictor, and what its training was like.

    Raises:
        ValueError: an unknown form, or a data set without curves in space.
    """
    if form not in FORMS:
        raise ValueError(f"unknown form '{form}'; there are {', '.join(FORMS)}")
    recipe = replace(recipe, preprocessing=_fitting(recipe.preprocessing, data))
    walks = walks_of(data, recipe.step_mm)
    clips, training = _clips(data, split, walks, recipe.size.frames, recipe.targets)
    learnt = [walks[index] for index in np.unique(clips.targets[:training])]
    positions = max(len(walk) for walk in learnt)
    spherical = None
    if form == "spherical":
        spherical = SphericalForm.fit(learnt, recipe.step_mm, cumulative=recipe.cumulative)
    objective = ShapeObjective(
        PictureStore(data.frames, CAMERA, recipe.preprocessing, pictures), clips, training, walks, positions,
        form=spherical, loss=recipe.loss, camera=data.camera_a, augmentation=recipe.augmentation,
        anchor=recipe.size.anchor,
    )  # fmt: skip
    torch.manual_seed(seed)
    network = build_shape_network(recipe.size, spherical, positions, pretrained=pretrained)
    _fill(network, objective.statistics())
    report = fit(network, objective, recipe.fit, folder=folder, seed=seed, ranks=ranks, progress=progress)
    told = {"form": form, "training_frames": len(learnt), "best_epoch": report.best_epoch, "step_mm": recipe.step_mm}
    return ShapePredictor.of(network, recipe.size, recipe.preprocessing, **told), report


def train_fgrn(
    data: Dataset,
    split: Split,
    recipe: FGRNRecipe,
    *,
    folder: Path,
    pictures: Path | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Progress | None = None,
) -> tuple[FGRNPredictor, FitReport]:
    """Trains 3D-FGRN; arguments and result as those of `train_shape`."""
    recipe = replace(recipe, preprocessing=_fitting(recipe.preprocessing, data))
    walks = walks_of(data, recipe.spacing_mm, chords=False)
    clips, training = _clips(data, split, walks, 1, 1)
    points = max(len(walks[index]) for index in np.unique(clips.targets[:training]))
    objective = ShapeObjective(
        PictureStore(data.frames, CAMERA, recipe.preprocessing, pictures), clips, training, walks, points,
        camera=data.camera_a, augmentation=recipe.augmentation, spacing_mm=recipe.spacing_mm,
    )  # fmt: skip
    torch.manual_seed(seed)
    network = build_fgrn(points, **recipe.sizes)
    _fill(network, objective.statistics())
    report = fit(network, objective, recipe.fit, folder=folder, seed=seed, ranks=ranks, progress=progress)
    told = {"training_frames": training, "best_epoch": report.best_epoch, "spacing_mm": recipe.spacing_mm}
    return FGRNPredictor(network, {"points": points, **recipe.sizes}, recipe.preprocessing, told), report


def train_segmenter(
    data: Dataset,
    split: Split,
    recipe: SegmentationRecipe,
    *,
    folder: Path,
    pictures: Path | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Progress | None = None,
) -> tuple[SegmentationPredictor, FitReport]:
    """Trains a segmentation network; arguments and result as those of `train_shape`."""
    recipe = replace(recipe, preprocessing=_fitting(recipe.preprocessing, data))
    stores = [PictureStore(data.frames, camera, recipe.preprocessing, pictures) for camera in VIEWS]
    training = images_of(data, split.train, recipe.images)
    objective = SegmentationObjective(
        stores, training, images_of(data, split.validation, recipe.validation_images), crop_px=recipe.crop_px,
        mask_px=recipe.mask_px, dice=recipe.dice, augmentation=recipe.augmentation,
    )  # fmt: skip
    size = {"name": recipe.network, "crop_px": recipe.crop_px, "sizes": recipe.sizes}
    torch.manual_seed(seed)
    network = built(size)
    sample = training[:: max(1, len(training) // 32)]
    seen = objective.batch(sample, np.random.default_rng(seed))["pictures"]
    _fill(network[0], {"pixel_mean": seen.mean(), "pixel_scale": seen.std().clamp(min=1.0)})  # type: ignore[index]
    report = fit(network, objective, recipe.fit, folder=folder, seed=seed, ranks=ranks, progress=progress)
    told = {"mask_px": recipe.mask_px, "training_images": len(training), "best_epoch": report.best_epoch}
    return SegmentationPredictor(network, size, recipe.preprocessing, told), report


def _fitting(preprocessing: Preprocessing, data: Dataset, camera: str = CAMERA) -> Preprocessing:
    """The recipe's preprocessing for images of the data set's size."""
    width, height = data.frames[0].size_px[camera]
    if width != height:
        raise ValueError(f"{data.root}: expected square images, got {width} x {height} px")
    return replace(preprocessing, source_px=width)


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
