"""Samples of random fluoroscopy: pictures of a pool, turned every way, and maps drawn without an image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.geometry.polyline import resample
from splineformer.learning.augmentation import Augmentation, Points, moved, recoloured, warped
from splineformer.learning.drawn_maps import drawn_map
from splineformer.learning.fluoroscopy_pool import NONE, SEVERAL, FluoroscopyPool
from splineformer.learning.targets import TARGETS, Targets
from splineformer.modeling.curve_network import CurveNetwork

_POINTS = 240
_NO_CURVE = np.column_stack([np.full(_POINTS, 0.5), np.linspace(0.4, 0.6, _POINTS)])  # counts in no loss

Indices = NDArray[np.int64]


class FluoroscopyObjective:
    """What a variant learns from random fluoroscopy; `guide3d.learning.training.fit` takes it.

    Every sample of training is drawn anew, by the generator of its epoch; items are numbers of samples.
    """

    def __init__(
        self,
        training: FluoroscopyPool,
        validation: FluoroscopyPool,
        network: CurveNetwork,
        *,
        samples: int,
        drawn: float,
        augmentation: Augmentation,
        background: int,
        weights: Any = None,
    ) -> None:
        """Args:
        samples: of an epoch.
        drawn: share of samples that are maps drawn without an image.
        augmentation: of the pictures of the pool; only its moves, and of grey levels what is not zero.
        background: grey level that comes in where a picture is moved.
        weights: of the variant's loss.

        Raises:
            ValueError: nothing to learn from.
        """
        if not len(training) and drawn < 1:
            raise ValueError("there is no image to learn from: draw some, or train on drawn maps alone")
        self.training, self.validation = training, validation
        self.training_items = np.arange(samples)
        self.validation_items = np.arange(len(validation))
        self.drawn, self.augmentation, self.background = drawn, augmentation, background
        self.size_px = int(network.settings.image_px)
        self.targets: Targets = TARGETS[network.variant](network, weights)

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch."""
        return self.targets.loss(module, batch)

    def batch(self, items: Indices, generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Pictures and targets as tensors: drawn and varied by the generator, or pictures of validation as they are."""
        if generator is None:
            chosen = self.validation
            images = torch.from_numpy(chosen.pictures[items].astype(np.float32))[:, None]
            return self._tensors(images, [_curve(chosen, item) for item in items], chosen.wires[items], None)
        directly = generator.random(len(items)) < self.drawn
        pool, maps = self._varied(int((~directly).sum()), generator), self._maps(int(directly.sum()), generator)
        images, curves, wires = (pool[0], pool[1] + maps[1], np.concatenate([pool[2], maps[2]]))
        images = torch.cat([images, maps[0]])
        order = generator.permutation(len(items))  # the first ones of a batch teach what looks from near by
        return self._tensors(images[order], [curves[place] for place in order], wires[order], generator)

    def _tensors(
        self, images: Tensor, curves: list[Points], wires: Indices, generator: np.random.Generator | None
    ) -> dict[str, Tensor]:
        return {
            "images": images,
            "wires": torch.from_numpy(wires),
            "inverted": torch.zeros(len(images)),
            **self.targets(curves, generator),
        }

    def _varied(self, count: int, generator: np.random.Generator) -> tuple[Tensor, list[Points], Indices]:
        """Pictures of the pool, moved, turned and mirrored together with their curves."""
        pool, size = self.training, self.size_px
        if not count:
            return torch.zeros(0, 1, size, size), [], np.zeros(0, np.int64)
        items = generator.integers(0, len(pool), count)
        images = torch.from_numpy(pool.pictures[items].astype(np.float32))[:, None]
        curves, ways = [], []
        for place, item in enumerate(items):
            curve = _curve(pool, item)
            if generator.random() < 0.5:
                images[place] = images[place].flip(2)
                curve = curve * (-1.0, 1.0) + (1.0, 0.0)
            curve, way = moved(curve, self.augmentation, generator)
            curves.append(curve)
            ways.append(way)
        images = warped(images - self.background, np.stack(ways)) + self.background
        return recoloured(images, self.augmentation, generator), curves, pool.wires[items]

    def _maps(self, count: int, generator: np.random.Generator) -> tuple[Tensor, list[Points], Indices]:
        maps = [drawn_map(generator, self.size_px) for _ in range(count)]
        if not maps:
            return torch.zeros(0, 1, self.size_px, self.size_px), [], np.zeros(0, np.int64)
        images = torch.from_numpy(np.stack([one.picture for one in maps]).astype(np.float32))[:, None]
        curves = [_NO_CURVE if one.curve is None else resample(one.curve, count=_POINTS) for one in maps]
        return images, curves, np.array([min(one.wires, SEVERAL) for one in maps], np.int64)


def _curve(pool: FluoroscopyPool, item: int) -> Points:
    return _NO_CURVE if pool.wires[item] == NONE else pool.curves[item]
