"""Predictors: uint8 images of a camera to a curve in millimetres, or to a mask; the border between numpy and torch."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array
from guide3d.learning.bounded_content import built_from
from guide3d.learning.build import ShapeSize, build_segmenter, from_spec, to_spec
from guide3d.learning.model_file import UNFIT, another_architecture, read_model, write_model
from guide3d.learning.picture_store import Preprocessing
from guide3d.modeling.shape_network import FGRN, ShapeNetwork

Images = NDArray[np.uint8]
_BATCH = 16
_OVERLAP = 0.125  # of a tile's side, at least


class _Predictor:
    """A network with the preprocessing of its images, kept in one file."""

    kind: ClassVar[str]
    build: Any  # takes sizes, returns the network

    def __init__(
        self, network: Any, size: dict[str, Any], preprocessing: Preprocessing, metadata: dict[str, Any]
    ) -> None:
        """Args:
        network: what `build` makes of `size`, trained.
        size: sizes of its parts, as the model file keeps them.
        """
        self.network, self.size, self.preprocessing, self.metadata = network.eval(), size, preprocessing, metadata

    def save(self, path: Path | str, *, half: bool = False) -> None:
        """Writes network, preprocessing and metadata into one file, whole or not at all.

        Args:
            half: weights in half precision, as they are shipped: half the size.
        """
        module = copy.deepcopy(self.network).half() if half else self.network
        write_model(
            path, kind=self.kind, network=self.size, preprocessing=asdict(self.preprocessing), module=module,
            metadata=self.metadata,
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path | str, device: str = "cpu") -> Self:
        """Reads a predictor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, of another kind, or its weights do not fit its sizes.
        """
        content = read_model(path, cls.kind)
        try:
            with built_from(content):
                network = cls.build(content["network"])
            network.load_state_dict(content["weights"])
            preprocessing = Preprocessing(**content["preprocessing"])
        except UNFIT as error:
            raise another_architecture(path, error) from error
        return cls(network.to(device), content["network"], preprocessing, content["metadata"])


class ShapePredictor(_Predictor):
    """Frames of one camera to the wire in space; `size` is what `build.to_spec` gives."""

    kind = "shape"
    network: ShapeNetwork
    build = staticmethod(from_spec)

    def predict(self, images: Sequence[Images] | Images) -> Array:
        """Predicts the wire at the last of some frames: (n, 3) mm, world, tip first.

        Args:
            images: frames in time order, (h, w) uint8 each, as the camera took them; only the last few count, and
                where there are fewer than the network sees, the first is repeated.

        Raises:
            ValueError: no image, or one of another size or type.
        """
        if not len(images):
            raise ValueError("expected at least one image, got none")
        frames = self.network.frames
        pictures = [self.preprocessing(image) for image in images[-frames:]]
        pictures = [pictures[0]] * (frames - len(pictures)) + pictures
        return self.predict_pictures(np.stack(pictures)[None])[0]

    def predict_pictures(self, windows: Images) -> list[Array]:
        """Predicts a curve (m, 3) mm for each prepared window, of windows (n, frames, size_px, size_px) uint8."""
        curves: list[Array] = []
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            for start in range(0, len(windows), _BATCH):
                part = torch.from_numpy(windows[start : start + _BATCH].astype(np.float32)).to(device)
                curves += [curve.double().cpu().numpy() for curve in self.network.curves(part)]
        return curves

    @classmethod
    def of(cls, network: ShapeNetwork, size: ShapeSize, preprocessing: Preprocessing) -> ShapePredictor:
        """The predictor of a network of some sizes, without metadata."""
        return cls(network, to_spec(size, network.form, network.positions), preprocessing, {})


class FGRNPredictor(_Predictor):
    """One image to a fixed number of points along the wire; `size` has the arguments of `FGRN`."""

    kind = "fgrn"
    network: FGRN
    build = staticmethod(lambda size: FGRN(**size))

    def predict(self, image: Images) -> Array:
        """Predicts the wire in an image; it has no stop, so points beyond the wire's end are predicted, too.

        Args:
            image: (h, w) uint8, as the camera took it.

        Returns:
            (points, 3) mm, world, tip first.
        """
        result: Array = self.predict_pictures(self.preprocessing(image)[None])[0]
        return result

    def predict_pictures(self, pictures: Images) -> Array:
        """(n, size_px, size_px) uint8, prepared already, to (n, points, 3) mm."""
        device = self.network.point_mean.device
        with torch.inference_mode():
            return self.network(torch.from_numpy(pictures.astype(np.float32)).to(device)).double().cpu().numpy()


def built(size: dict[str, Any]) -> torch.nn.Module:
    """A segmentation network, its first layer after one that makes grey values of 0 to 255 into about -1 to 1."""
    return torch.nn.Sequential(Scaled(), build_segmenter(size["name"], size["crop_px"], **size["sizes"]))


class Scaled(torch.nn.Module):
    """Grey values with mean and scale of what was learnt from taken out."""

    pixel_mean: torch.Tensor
    pixel_scale: torch.Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("pixel_mean", torch.zeros(()))
        self.register_buffer("pixel_scale", torch.ones(()))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Any shape to the same."""
        return (images - self.pixel_mean) / self.pixel_scale


class SegmentationPredictor(_Predictor):
    """An image to the mask of the wire; `size` has ``name``, ``crop_px`` and ``sizes`` of `build.build_segmenter`."""

    kind = "segmentation"
    build = staticmethod(built)

    def predict(self, image: Images) -> Images:
        """Predicts the mask (h, w) uint8, 255 on the wire, of an image (h, w) uint8, as the camera took it."""
        return np.where(self.enlarged(self.chances(self.preprocessing(image))) >= 0.5, 255, 0).astype(np.uint8)

    def chances(self, picture: Images) -> NDArray[np.float32]:
        """The chance, 0 to 1, of each pixel of a picture (size_px, size_px) uint8, prepared already, to be wire.

        Tiles that the network can see at once overlap; there, what lies further from a tile's border counts more.
        """
        side, tile = picture.shape[0], self.size["crop_px"]
        corners = _corners(side, tile)
        weight = _weight(tile)
        total, weights = np.zeros(picture.shape, np.float32), np.zeros(picture.shape, np.float32)
        device = next(self.network.parameters()).device
        places = [(row, column) for row in corners for column in corners]
        tiles = np.stack([picture[row : row + tile, column : column + tile] for row, column in places])
        with torch.inference_mode():
            for start in range(0, len(places), 4):
                part = torch.from_numpy(tiles[start : start + 4].astype(np.float32))[:, None].to(device)
                chance = self.network(part).float().sigmoid()[:, 0].cpu().numpy()
                for (row, column), one in zip(places[start : start + 4], chance, strict=True):
                    total[row : row + tile, column : column + tile] += weight * one
                    weights[row : row + tile, column : column + tile] += weight
        return total / weights

    def enlarged(self, chances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Chances at the size of the camera's image, interpolated."""
        side = self.preprocessing.source_px
        if chances.shape[0] == side:
            return chances
        one = torch.from_numpy(chances)[None, None]
        big = torch.nn.functional.interpolate(one, size=(side, side), mode="bilinear", align_corners=False)
        return big[0, 0].numpy()


def _corners(side: int, tile: int) -> list[int]:
    if tile >= side:
        return [0]
    count = math.ceil((side - tile) / (tile * (1 - _OVERLAP))) + 1
    return np.linspace(0, side - tile, count).round().astype(int).tolist()


def _weight(tile: int) -> NDArray[np.float32]:
    edge = np.minimum(np.arange(tile), np.arange(tile)[::-1]) + 1.0
    ramp = np.minimum(edge / (tile * _OVERLAP), 1.0)
    return np.outer(ramp, ramp).astype(np.float32)
