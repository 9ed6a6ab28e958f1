"""Samples of segmentation: crops of both cameras' images, most of them about the wire, and the wire's mask there."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.dataset.dataset import VIEWS
from guide3d.learning.losses import segmentation_loss
from guide3d.learning.picture_store import PictureStore, averaged, replace_unreadable
from guide3d.learning.precision import bfloat16_on_processor
from guide3d.setting_kinds import Grey, Logarithm, Share, settings


@settings
class SegmentationAugmentation:
    """How crops are varied in training.

    Attributes:
        gain: contrast is multiplied by a factor of exp(±gain).
        offset: largest change of brightness, of 255.
        noise: largest standard deviation of noise, of 255.
        on_wire: share of the crops that are centred near the wire.
    """

    gain: Logarithm = 0.3
    offset: Grey = 20.0
    noise: Grey = 5.0
    on_wire: Share = 0.8


class SegmentationObjective:
    """What the segmentation networks learn: crops to masks."""

    def __init__(
        self,
        stores: Sequence[PictureStore],
        training: NDArray[np.int64],
        validation: NDArray[np.int64],
        *,
        crop_px: int,
        mask_px: float,
        dice: float = 0.5,
        augmentation: SegmentationAugmentation | None = None,
    ) -> None:
        """Args:
        stores: of pictures, one a camera.
        training: images to learn from, as `images_of` lists them.
        mask_px: width of the wire, in px of the camera's image.
        """
        self.stores, self.training_items, self.validation_items = stores, training, validation
        self.crop_px, self.mask_px, self.dice = crop_px, mask_px, dice
        self.augmentation = augmentation or SegmentationAugmentation()
        self._masks: dict[int, bytes] = {}
        if not len(training):
            raise ValueError("there is no image to learn from: the data set's training part is empty")

    def mask(self, item: int) -> NDArray[np.uint8]:
        """How much of each pixel of the picture is wire, 0 to 255.

        Shares instead of yes and no tell where between two pixels the wire ends, so that a mask predicted on a small
        picture is sharp on the camera's image.
        """
        size = self.stores[0].preprocessing.size_px
        if item not in self._masks:
            camera, index = divmod(item, len(self.stores[0].frames))
            drawn = self.stores[camera].frames[index].mask(VIEWS[camera], self.mask_px)
            self._masks[item] = zlib.compress(averaged(drawn, size).tobytes(), 1)
        return np.frombuffer(zlib.decompress(self._masks[item]), np.uint8).reshape(size, size)

    def healthy(self, items: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Returns whether each image can be read, (n,)."""
        places = (divmod(int(item), len(self.stores[0].frames)) for item in items)
        return np.array([self.stores[camera].healthy(np.array([index]))[0] for camera, index in places], bool)

    @property
    def damaged(self) -> list[str]:
        """Names of the frames whose image could not be read so far."""
        return [name for store in self.stores for name in store.damaged]

    def batch(self, items: NDArray[np.int64], generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Crops and their masks as tensors; images that cannot be read are replaced by others.

        In validation the crop is about the middle of the wire, always the same.
        """
        pictures, masks = [], []
        for item in replace_unreadable(self, items, generator):
            camera, index = divmod(int(item), len(self.stores[0].frames))
            whole, mask = self.stores[camera].pictures(np.array(index)), self.mask(int(item))
            rows, columns = self._crop(mask, generator)
            picture, mask = whole[rows, columns].astype(np.float32), mask[rows, columns]
            if generator is not None:
                picture, mask = self._varied(picture, mask, generator)
            pictures.append(picture)
            masks.append(mask)
        return {
            "pictures": torch.from_numpy(np.stack(pictures))[:, None],
            "masks": torch.from_numpy(np.stack(masks).astype(np.float32) / 255)[:, None],
        }

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Loss of a batch."""
        with bfloat16_on_processor():
            logits = module(batch["pictures"])
        return segmentation_loss(logits.float(), batch["masks"], dice=self.dice)

    def _crop(self, mask: NDArray[np.uint8], generator: np.random.Generator | None) -> tuple[slice, slice]:
        slack = mask.shape[0] - self.crop_px
        on_wire = generator is None or generator.uniform() < self.augmentation.on_wire
        places = np.argwhere(mask) if on_wire and slack else np.zeros((0, 2), int)
        if len(places):
            near = places[len(places) // 2 if generator is None else generator.integers(len(places))]
            jitter = 0 if generator is None else generator.integers(-self.crop_px // 3, self.crop_px // 3 + 1, 2)
            corner = np.clip(near + jitter - self.crop_px // 2, 0, slack)
        elif generator is None:
            corner = np.array([slack // 2, slack // 2])
        else:
            corner = generator.integers(0, slack + 1, 2)
        return slice(corner[0], corner[0] + self.crop_px), slice(corner[1], corner[1] + self.crop_px)

    def _varied(
        self, picture: NDArray[np.float32], mask: NDArray[np.uint8], generator: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        with_ = self.augmentation
        for axis in (0, 1):  # mirrored and transposed: a wire may run anywhere
            if generator.uniform() < 0.5:
                picture, mask = np.flip(picture, axis), np.flip(mask, axis)
        if generator.uniform() < 0.5:
            picture, mask = picture.T, mask.T
        middle = picture.mean()
        factor = np.exp(generator.uniform(-with_.gain, with_.gain))
        picture = middle + factor * (picture - middle) + generator.uniform(-with_.offset, with_.offset)
        if with_.noise:
            spread = generator.uniform(0, with_.noise)
            picture = picture + spread * generator.standard_normal(picture.shape, np.float32)
        return np.clip(picture, 0, 255).astype(np.float32), mask
