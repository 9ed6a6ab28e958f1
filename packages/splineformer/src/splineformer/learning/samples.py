"""Samples: images of both cameras at the network's size with their curves, varied in training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.dataset.dataset import VIEWS
from guide3d.geometry.polyline import arc_length, at_length, resample
from splineformer.decoding import collocation, padded
from splineformer.learning.augmentation import (
    Augmentation,
    at_shares,
    inside,
    moved,
    recoloured,
    shadow,
    warped,
    without_wire,
)
from splineformer.learning.curve_perturbation import drifted
from splineformer.learning.losses import OrderedWeights, PublishedWeights, ordered_loss, published_loss
from splineformer.modeling.image_head import WIRES
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.splineformer import SplineFormer
from splineformer.tokens import TokenSettings, tokens_of_polyline

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset

_DENSE = 240  # points of a curve that is kept
_CURVE_SAMPLES = 128  # of the ordered variant's curve loss
_NEAR_PCT = 40  # of a batch's images teach what looks from near by: it learns sooner than the overview, and costs more
_BEGINS = 0.4  # share of samples whose tip and refinements begin near the true curve, not where the overview says
_BEND = 8 / 1024  # of the side: turns are counted between steps of this length
_NONE, _ONE, _SEVERAL = range(len(WIRES))

Indices = NDArray[np.int64]


class Pictures(Protocol):
    """Small images by index, such as `guide3d.learning.picture_store.PictureStore`."""

    def healthy(self, indices: Indices) -> NDArray[np.bool_]:
        """Whether each can be read."""

    def pictures(self, indices: Indices) -> NDArray[np.uint8]:
        """(n, size, size) images."""


def shares_of_pixels(points_px: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Pixel coordinates, (0, 0) the first pixel's centre, to shares of the image's sides, 0 its border."""
    return (np.asarray(points_px, float) + 0.5) / np.asarray(size_px, float)


def pixels_of_shares(shares: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Shares of the image's sides to pixel coordinates."""
    return np.asarray(shares, float) * np.asarray(size_px, float) - 0.5


def curves_of(data: Dataset) -> list[NDArray[np.float64] | None]:
    """The curves of all images, camera A first: dense points as shares of the sides; None where it is too short."""
    curves: list[NDArray[np.float64] | None] = []
    for camera in VIEWS:
        for frame in data.frames:
            kept = inside(shares_of_pixels(frame.polyline(camera), frame.size_px[camera]))
            curves.append(None if kept is None else resample(kept, count=_DENSE))
    return curves


def course_of(curve: NDArray[np.float64], steps: int, step: float) -> NDArray[np.float64]:
    """A curve from its end on, in equal steps; beyond the tip it goes straight on.

    Args:
        curve: (n, 2) tip first.
        steps: how many points.
        step: between them, in the curve's unit.

    Returns:
        (steps, 2).
    """
    length = arc_length(curve)[-1]
    at = length - step * np.arange(steps)
    ahead = curve[0] - at_length(curve, min(step, length))
    ahead /= max(float(np.linalg.norm(ahead)), 1e-12)
    return at_length(curve, np.maximum(at, 0.0)) + np.maximum(-at, 0.0)[:, None] * ahead


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
    """What both variants learn; `guide3d.learning.training.fit` takes it."""

    def __init__(
        self,
        stores: Sequence[Pictures],
        curves: Sequence[NDArray[np.float64] | None],
        training: Indices,
        validation: Indices,
        network: SplineFormer | OrderedSplineFormer,
        *,
        augmentation: Augmentation | None = None,
        weights: PublishedWeights | OrderedWeights | None = None,
        source_px: int = 1024,
    ) -> None:
        """Args:
        stores: of pictures, one a camera, all with as many frames.
        curves: of all images, as `curves_of` gives them.
        training: images to learn from, as `images_of` lists them.
        validation: images to validate with.
        network: that learns; decides which targets a batch has.
        augmentation: of what is learnt from.
        weights: of the loss.
        source_px: side of the camera's images, in which the tokens' tolerance is meant.

        Raises:
            ValueError: nothing to learn from.
        """
        self.stores, self.curves, self.source_px = stores, curves, source_px
        self.frames = len(curves) // len(stores)
        self.training_items, self.validation_items = self._with_curves(training), self._with_curves(validation)
        self.augmentation = augmentation or Augmentation()
        turn = self.augmentation.turn_a_pass
        passes = [passes_of(np.asarray(curves[item]), turn) for item in self.training_items]
        self.training_items = np.repeat(self.training_items, passes)
        if not len(self.training_items):
            raise ValueError("there is no image to learn from: the data set's training part is empty")
        self.targets: Callable[[list[NDArray[np.float64]], np.random.Generator | None], dict[str, Tensor]]
        if isinstance(network, SplineFormer):
            published = weights if isinstance(weights, PublishedWeights) else PublishedWeights()
            self.tokens = TokenSettings(limit=network.settings.limit)
            self.targets = self._token_targets
            self._loss = lambda module, batch: published_loss(
                module(batch["images"], batch["tokens"][:, :-1]), batch, published
            )
        else:
            ordered = weights if isinstance(weights, OrderedWeights) else OrderedWeights()
            self.shares = network.shares.double().cpu().numpy()
            self.steps, self.step = network.settings.steps, network.step
            parameters = torch.linspace(0, 1, _CURVE_SAMPLES, dtype=torch.float64)
            self.curve_shares = parameters.numpy()
            self.bases = collocation(network.knots.double().cpu(), parameters).float()
            self.targets = self._point_targets
            sights = [step.sight for step in network.refinements()]
            self._loss = lambda module, batch: ordered_loss(
                module(batch["images"], batch["starts"], batch["begins"]),
                batch,
                ordered,
                self.bases.to(batch["images"].device),
                network.shares,
                sights,
            )

    def _with_curves(self, items: Indices) -> Indices:
        return np.array([item for item in items if self.curves[item] is not None], np.int64)

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch."""
        return self._loss(module, batch)

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
        images = torch.where(torch.from_numpy(turned)[:, None, None, None], 255.0 - images, images)
        return images, [pair[0] for pair in pairs]

    def _second_shadow(self, generator: np.random.Generator) -> Tensor:
        """Another image's wire, mirrored, so that it does not lie where the first one does."""
        other = self._readable(generator.choice(self.training_items, 1), generator)
        image = self._images(other)[0]
        curve = np.asarray(self.curves[int(other[0])])
        return shadow(image, without_wire(image, curve, generator)).flip(1 if generator.uniform() < 0.7 else 2)

    def _token_targets(
        self, curves: list[NDArray[np.float64]], unused: np.random.Generator | None = None
    ) -> dict[str, Tensor]:
        sequences = []
        for curve in curves:
            fitted = tokens_of_polyline(curve * self.source_px, self.tokens)
            units = np.array([fitted[-1, 0], self.source_px, self.source_px])
            sequences.append(torch.from_numpy((fitted / units).astype(np.float32)))
        tokens, lengths = padded(sequences, self.tokens.limit)
        return {"tokens": tokens, "lengths": lengths}

    def _point_targets(
        self, curves: list[NDArray[np.float64]], generator: np.random.Generator | None = None
    ) -> dict[str, Tensor]:
        def at(shares: NDArray[np.float64]) -> Tensor:
            return torch.from_numpy(np.stack([at_shares(curve, shares) for curve in curves]).astype(np.float32))

        points = at(self.shares)
        courses = [course_of(curve, self.steps, self.step) for curve in curves]
        lengths = torch.tensor([arc_length(curve)[-1] / self.step for curve in curves], dtype=torch.float32)
        told = {
            "points": points,
            "curve": at(self.curve_shares),
            "course": torch.from_numpy(np.stack(courses).astype(np.float32)),
            "length": lengths.clamp(1.0, self.steps - 1.0),
        }
        if generator is None:
            return told | {"starts": points, "begins": torch.zeros(len(curves), dtype=torch.bool)}
        near = -(-len(curves) * _NEAR_PCT // 100)
        begins = torch.from_numpy(generator.uniform(size=near) < _BEGINS)
        return told | {"starts": drifted(points[:near], generator), "begins": begins}

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
