"""Samples of random fluoroscopy: pictures and curves of a pool, drawn once and kept, varied in training."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.files import whole_file
from guide3d.geometry.polyline import arc_length, resample
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from splineformer.image_input import shares_of_pixels
from splineformer.learning.augmentation import Augmentation, Points, inside, moved, recoloured, warped
from splineformer.learning.drawn_maps import drawn_map
from splineformer.learning.targets import TARGETS, Targets
from splineformer.modeling.curve_network import WIRES, CurveNetwork

IDENTITY = "pool.json"
_PART = 50  # images of a file
_SHORTEST_PX = 20.0  # of a wire that counts
_POINTS = 240  # of a curve that is kept
_NEAR_PX = 1.0
NONE, ONE, SEVERAL = range(len(WIRES))

PictureMaker = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
_NO_CURVE = np.column_stack([np.full(_POINTS, 0.5), np.linspace(0.4, 0.6, _POINTS)])  # counts in no loss
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FluoroscopyPool:
    """Pictures and what they show.

    Attributes:
        pictures: (n, size, size) uint8.
        curves: (n, 240, 2) shares of the side, tip first: of the wire, or of one of several; NaN where there is none.
        wires: (n,) index of `splineformer.modeling.curve_network.WIRES`.
    """

    pictures: NDArray[np.uint8]
    curves: NDArray[np.float64]
    wires: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pictures)


def draw_pool(
    fluoroscopy: RandomFluoroscopy,
    indices: range,
    picture: PictureMaker,
    source: str,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FluoroscopyPool:
    """Draws the pictures of some indices; of a folder's, those are read that were drawn before.

    Images of one wire whose tip lies outside the field are left out: nothing says which of its ends is the tip.

    Args:
        picture: makes a network's picture of an image (h, w) uint8.
        source: what it makes them of, for the folder to be recognised by.
        folder: that keeps them; None: none.
        progress: called with the number of images drawn and of all, after every fifty.

    Raises:
        ValueError: the folder holds other pictures, or a damaged file; every image was left out.
    """
    if folder is not None:
        _require_same(folder / IDENTITY, fluoroscopy, source)
    parts = []
    for first in range(indices.start, indices.stop, _PART):
        last = min(first + _PART, indices.stop)
        file = None if folder is None else folder / f"pool_{first}_{last}.npz"
        if file is not None and file.is_file():
            parts.append(_kept(file))
        else:
            parts.append(_drawn(fluoroscopy, range(first, last), picture))
            if file is not None:
                with whole_file(file) as stream:
                    pictures, curves, wires = parts[-1]
                    np.savez_compressed(stream, pictures=pictures, curves=curves, wires=wires)
        if progress is not None:
            progress(last - indices.start, len(indices))
    columns = list(zip(*(part for part in parts if len(part[2])), strict=True))
    if not columns:
        raise ValueError(f"none of {len(indices)} random images could be used: draw more")
    return FluoroscopyPool(np.concatenate(columns[0]), np.concatenate(columns[1]), np.concatenate(columns[2]))


def curve_of(drawn: RandomImage) -> tuple[int, Points | None]:
    """The number of wires that a random image shows, as an index of `WIRES`, and the curve to be read.

    Returns:
        Without a curve where there is no wire, or where the only one has its tip outside the field.
    """
    side = len(drawn.image)
    wires = [parts for parts in drawn.wires if sum(arc_length(part)[-1] for part in parts) >= _SHORTEST_PX]
    curves = [inside(shares_of_pixels(parts[0], (side, side))) for parts in wires if _tip_is_seen(parts[0], drawn.tips)]
    single = [curve for curve in curves if curve is not None]
    return min(len(wires), SEVERAL), single[0] if single else None


def _tip_is_seen(points: Points, tips: Points) -> bool:
    return bool(len(tips)) and float(np.abs(tips - points[0]).max(axis=1).min()) <= _NEAR_PX


def _drawn(
    fluoroscopy: RandomFluoroscopy, indices: Iterable[int], picture: PictureMaker
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int64]]:
    pictures, curves, kinds = [], [], []
    for index in indices:
        drawn = fluoroscopy.image(index)
        wires, curve = curve_of(drawn)
        if wires != NONE and curve is None:
            continue
        pictures.append(picture(drawn.image))
        curves.append(np.full((_POINTS, 2), np.nan) if curve is None else resample(curve, count=_POINTS))
        kinds.append(wires)
    if not kinds:  # the sizes of pictures are not known then
        return np.empty((0, 0, 0), np.uint8), np.empty((0, _POINTS, 2)), np.empty(0, np.int64)
    return np.stack(pictures), np.stack(curves), np.array(kinds, np.int64)


def _require_same(path: Path, fluoroscopy: RandomFluoroscopy, source: str) -> None:
    identity = {"source": source, "seed": fluoroscopy.seed, "settings": asdict(fluoroscopy.settings)}
    if not path.is_file():
        with whole_file(path, "w") as file:
            json.dump(identity, file, indent=1)
        return
    if json.loads(path.read_text(encoding="utf-8")) != identity:
        raise ValueError(f"{path.parent} holds pictures of another seed, source or settings: give another folder")


def _kept(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int64]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return file["pictures"], file["curves"], file["wires"]
    except Exception as error:  # a damaged archive raises a dozen kinds
        raise ValueError(f"{path} is damaged ({error}): remove it, and it is drawn again") from error


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
    ) -> None:
        """Args:
        samples: of an epoch.
        drawn: share of samples that are maps drawn without an image.
        augmentation: of the pictures of the pool; only its moves, and of grey levels what is not zero.
        background: grey level that comes in where a picture is moved.

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
        self.targets: Targets = TARGETS[network.variant](network)

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
