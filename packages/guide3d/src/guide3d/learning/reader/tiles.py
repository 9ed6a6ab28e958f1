"""Tiles for the reader's training: drawn on the fly by processes of their own, in the order of their indices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from guide3d.modeling.reader_network import reader_input
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings

_AHEAD = 6  # batches that each process draws in advance


class ReaderTiles(Dataset):
    """The network's input and target of random tiles by index."""

    def __init__(
        self,
        settings: FluoroscopySettings,
        seed: int,
        tile_px: int,
        courses: Sequence[NDArray[np.floating]] = (),
        backgrounds: Sequence[NDArray[np.floating]] = (),
    ) -> None:
        """Args:
        courses: and backgrounds: see `guide3d.random_fluoroscopy.random_fluoroscopy.RandomFluoroscopy`.
        """
        self.fluoroscopy = RandomFluoroscopy(settings, seed, courses, backgrounds)
        self.tile_px = tile_px

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """Input (2, h, w) and target (3, h, w) of a tile, 16 bits each, which halves what passes between processes."""
        drawn = self.fluoroscopy.tile(index, self.tile_px)
        return torch.from_numpy(reader_input(drawn.image)).half(), torch.from_numpy(reader_target(drawn)).half()


def reader_target(drawn: RandomImage) -> NDArray[np.float32]:
    """What the network is to give for an image: (3, h, w), 0 to 1, of wire, catheter and tip."""
    return np.stack((drawn.wire / np.float32(255), drawn.catheter / np.float32(255), drawn.tip))


def tile_batches(
    tiles: ReaderTiles, first_step: int, steps: int, batch_size: int, processes: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Batches of the steps `first_step` to `steps` - 1, float32, the same whatever the number of processes.

    Args:
        processes: that draw; 0: this one.
    """
    indices = range(first_step * batch_size, steps * batch_size)
    loader = DataLoader(
        tiles, batch_size, sampler=indices, num_workers=processes, worker_init_fn=_one_thread,
        prefetch_factor=_AHEAD if processes else None,
    )  # fmt: skip
    for images, targets in loader:
        yield images.float(), targets.float()


def _one_thread(_: int) -> None:
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
