"""Samples: images of both cameras at the network's size with their curves, varied in training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.dataset.dataset import VIEWS
from guide3d.geometry.polyline import arc_length, resample
from splineformer.image_input import shares_of_pixels
from splineformer.learning.augmentation import (
    Augmentation,
    inside,
    moved,
    recoloured,
    shadow,
    warped,
    without_wire,
)
from splineformer.learning.targets import TARGETS, Targets
from splineformer.modeling.curve_network import WIRES, CurveNetwork

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset

_DENSE = 240  # points of a curve that is kept
_BEND = 8 / 1024  # of the side: turns are counted between steps of this length
_NONE, _ONE, _SEVERAL = range(len(WIRES))

Indices = NDArray[np.int64]


class Pictures(Protocol):
    """Small images by index, such as `guide3d.learning.picture_store.PictureStore`."""

    def healthy(self, indices: Indices) -> NDArray[np.bool_]:
        """Whether each can be read."""

    def pictures(self, indices: Indices) -> NDArray[np.uint8]:
        """(n, size, size) images."""


def curves_of(data: Dataset) -> list[NDArray[np.float64] | None]:
    """The curves of all images, camera A first: dense points as shares of the sides; None where it is too short."""
    curves: list[NDArray[np.float64] | None] = []
    for camera in VIEWS:
        for frame in data.frames:
            seen = inside(shares_of_pixels(frame.polyline(camera), frame.size_px[camera]))
            curves.append(None if seen is None else resample(seen, count=_DENSE))
    return curves


def passes_of(curve: NDArray[np.float64], turn: float) -> int:
    """How often a pass over the samples meets a curve: hairpins and loops, which are rare and hard, the oftener.

    Args:
        curve: (n, 2) shares of the side.
        turn: rad that earn a meeting, all bends together; 0: every curve is met once.
    """
    if not turn:
        return 1
    steps = np.diff(resample(curve, count=max(3, round(arc_length(curve)[-1] / _BEND) + 1)), axis=0)
    turns = np.diff(np.arctan2(steps[:, 1], steps[:, 0]))
    turned = float(np.abs((turns + np.pi) % (2 * np.pi) - np.pi).sum())
    return max(1, round(turned / turn))


class SplineObjective:
    """What a variant learns; `guide3d.learning.training.fit` takes it."""

    def __init__(
        self,
        stores: Sequence[Pictures],
        curves: Sequence[NDArray[np.float64] | None],
        training: Indices,
        validation: Indices,
        network: CurveNetwork,
        *,
        augmentation: Augmentation | None = None,
    ) -> None:
        """Args:
        stores: of pictures, one a camera, all with as many frames.
        curves: of all images, as `curves_of` gives them.
        training: images to learn from, as `images_of` lists them.
        network: that learns; its variant decides which targets a batch has.

        Raises:
            ValueError: nothing to learn from.
        """
        self.stores, self.curves = stores, curves
        self.frames = len(curves) // len(stores)
        self.training_items, self.validation_items = self._with_curves(training), self._with_curves(validation)
        self.augmentation = augmentation or Augmentation()
        turn = self.augmentation.turn_a_pass
        passes = [passes_of(np.asarray(curves[item]), turn) for item in self.training_items]
        self.training_items = np.repeat(self.training_items, passes)
        if not len(self.training_items):
            raise ValueError("there is no image to learn from: the data set's training part is empty")
        self.targets: Targets = TARGETS[network.variant](network)

    def _with_curves(self, items: Indices) -> Indices:
        return np.array([item for item in items if self.curves[item] is not None], np.int64)

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch."""
        return self.targets.loss(module, batch)

    def batch(self, items: Indices, generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Images and targets as tensors; varied where there is a generator; unreadable images are replaced."""
        items = self._readable(items, generator)
        images = self._images(items)
        curves = [np.asarray(self.curves[item]) for item in items]
        wires, inverted = np.full(len(items), _ONE), np.zeros(len(items), np.float32)
        if generator is not None:
            images, curves = self._varied(images, curves, wires, inverted, generator)
        return {
            "images": images,
            "wires": torch.from_numpy(wires),
            "inverted": torch.from_numpy(inverted),
            **self.targets(curves, generator),
        }

    def _images(self, items: Indices) -> Tensor:
        rows = [self.stores[int(item) // self.frames].pictures(np.array([item % self.frames])) for item in items]
        return torch.from_numpy(np.stack(rows).astype(np.float32))

    def _varied(
        self,
        images: Tensor,
        curves: list[NDArray[np.float64]],
        wires: NDArray[np.int64],
        inverted: NDArray[np.float32],
        generator: np.random.Generator,
    ) -> tuple[Tensor, list[NDArray[np.float64]]]:
        with_ = self.augmentation
        for place in range(len(images)):
            drawn = generator.uniform()
            if drawn < with_.empty:
                images[place] = without_wire(images[place], curves[place], generator)
                wires[place] = _NONE
            elif drawn < with_.empty + with_.several:
                images[place] *= self._second_shadow(generator)
                wires[place] = _SEVERAL
        pairs = [moved(curve, with_, generator) for curve in curves]
        images = recoloured(warped(images, np.stack([pair[1] for pair in pairs])), with_, generator)
        turned = generator.uniform(size=len(images)) < with_.inverted
        inverted[turned] = 1.0
        images[turned] = 255.0 - images[turned]
        return images, [pair[0] for pair in pairs]

    def _second_shadow(self, generator: np.random.Generator) -> Tensor:
        """Another image's wire, mirrored, so that it does not lie where the first one does."""
        other = self._readable(generator.choice(self.training_items, 1), generator)
        image = self._images(other)[0]
        curve = np.asarray(self.curves[int(other[0])])
        return shadow(image, without_wire(image, curve, generator)).flip(1 if generator.uniform() < 0.7 else 2)

    def _readable(self, items: Indices, generator: np.random.Generator | None) -> Indices:
        """The items, each damaged one replaced by the next readable one of the same part."""
        good = self._healthy(items)
        if good.all():
            return items
        part = self.training_items if generator is not None else self.validation_items
        readable = part[self._healthy(part)]
        if not len(readable):
            raise ValueError("not one image of this part of the data set can be read: look at the warnings above")
        after = np.searchsorted(np.sort(readable), items) % len(readable)
        return np.where(good, items, np.sort(readable)[after])

    def _healthy(self, items: Indices) -> NDArray[np.bool_]:
        healthy = np.zeros(len(items), bool)
        for camera, store in enumerate(self.stores):
            own = items // self.frames == camera
            if own.any():
                healthy[own] = store.healthy(items[own] % self.frames)
        return healthy
