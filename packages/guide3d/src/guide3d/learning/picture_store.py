"""Pictures of a data set as networks take them: prepared, and kept in memory or in a folder."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from guide3d.image_filters import closed, mean_around
from guide3d.opencv import cv2
from guide3d.setting_kinds import Pixels, PixelsOrNone, Positive, settings

if TYPE_CHECKING:
    from guide3d.dataset.frame import Frame


Picture = NDArray[np.uint8]
_MIDDLE = 128.0


UNREAD, READY, DAMAGED = 0, 1, 2
_NAMED = 5  # damaged images of a store that the log names one by one
_DRAWS = 50  # of another item in place of one that cannot be read
_LOGGER = logging.getLogger(__name__)


@settings
class Preprocessing:
    """How pictures are made.

    Attributes:
        source_px: side of the camera's image, which positions and masks belong to.
        line_px: width, in px of the camera's image, below which dark lines are kept and all else is taken away (closing
            minus image); 0: the grey values as they are.
        flat_px: side, in px of the picture, of the square whose mean is taken away from each pixel: slow shades of body
            and detector become 128; 0: they stay.
        gain: of the lines, or of what is left of the grey values.
        first_px: side, in px of the camera's image, of the squares that are averaged before lines are looked for: it
            takes away noise and most of the work.
    """

    size_px: Pixels
    source_px: Pixels = 1024
    line_px: PixelsOrNone = 0
    flat_px: PixelsOrNone = 0
    gain: Positive = 1.0
    first_px: Pixels = 1

    def __post_init__(self) -> None:
        """Refuses sizes that make no picture."""
        if self.source_px < self.size_px:
            raise ValueError(f"expected pictures of 1 to {self.source_px} px, got {self.size_px}")
        if self.line_px and self.flat_px:
            raise ValueError("give line_px or flat_px: lines have no shades to take away")
        if self.source_px % self.first_px:
            raise ValueError(f"first_px must divide {self.source_px}, got {self.first_px}")

    def __call__(self, image: NDArray[np.uint8]) -> Picture:
        """Makes a picture (size_px, size_px) uint8, area-averaged, of an image (source_px, source_px) uint8.

        Raises:
            ValueError: an image of another size or type.
        """
        expected = (self.source_px, self.source_px)
        if image.shape != expected or image.dtype != np.uint8:
            raise ValueError(
                f"expected an image of {expected[1]} x {expected[0]} px, uint8, got {image.shape}, {image.dtype}: "
                "the network was trained on that size, and its camera belongs to it"
            )
        if self.line_px:
            sharp = averaged(image, self.source_px // self.first_px)
            lines = dark_lines(sharp, self.line_px // self.first_px | 1).astype(np.float32)
            return np.clip(self.gain * averaged(lines, self.size_px), 0, 255).astype(np.uint8)
        if self.flat_px:
            grey = averaged(image.astype(np.float32), self.size_px)
            left = grey - mean_around(grey, self.flat_px)
            return np.clip(_MIDDLE + self.gain * left, 0, 255).astype(np.uint8)
        return averaged(image, self.size_px)


def averaged(image: NDArray[Any], size_px: int) -> NDArray[Any]:
    """Reduces a square image (h, h) by averaging areas."""
    if image.shape == (size_px, size_px):
        return image
    return np.asarray(cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA))


def dark_lines(image: NDArray[np.uint8], width_px: int) -> Picture:
    """How much darker (h, w) uint8 images are than their surroundings, where narrower than a square of some width."""
    smooth = mean_around(image, 3)  # one bright pixel must not open a line
    return closed(smooth, width_px) - smooth


class PictureStore:
    """Pictures of frames by index, in memory or in files that several processes share."""

    def __init__(
        self, frames: Sequence[Frame], camera: str, preprocessing: Preprocessing, folder: Path | None = None
    ) -> None:
        """Args:
        camera: "a" or "b".
        folder: keeps pictures from one run to the next; None: in memory.
        """
        self.frames, self.camera, self.preprocessing = frames, camera, preprocessing
        size = preprocessing.size_px
        shape = (len(frames), size, size)
        self._state: NDArray[np.uint8]
        self._pictures: NDArray[np.uint8]
        if folder is None:
            self._state, self._pictures = np.zeros(len(frames), np.uint8), np.zeros(shape, np.uint8)
        else:
            # one file: of two, a process that makes them at the same time could share the state alone, and take
            # pictures for ready that lie in the other's file
            stored = _shared(folder / f"prepared-{camera}-{size}-{self._fingerprint()}.pictures", len(frames), size)
            self._state, self._pictures = stored[: len(frames)], stored[len(frames) :].reshape(shape)
        self._damaged: set[int] = set()

    def healthy(self, indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Reads what has not been read yet of frames (indices of any shape); returns whether each can be used."""
        for index in np.unique(indices).tolist():
            # A picture found damaged by an earlier run may have been mended.
            if self._state[index] != READY and index not in self._damaged:
                self._read(index)
        return np.asarray(self._state[indices] == READY)

    def pictures(self, indices: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Returns pictures (..., size_px, size_px) uint8 of frames (indices of any shape); of damaged images zeros."""
        self.healthy(indices)
        return np.asarray(self._pictures[indices])

    @property
    def damaged(self) -> list[str]:
        """Names of the frames whose image could not be read so far."""
        return [self.frames[index].label for index in sorted(self._damaged)]

    def _read(self, index: int) -> None:
        frame = self.frames[index]
        try:
            picture = self.preprocessing(frame.image(self.camera))
        except (ValueError, OSError) as error:
            self._damaged.add(index)
            self._state[index] = DAMAGED
            if len(self._damaged) <= _NAMED:
                _LOGGER.warning("frame %s is skipped: %s", frame.label, error)
            elif len(self._damaged) == _NAMED + 1:
                _LOGGER.warning("more frames are skipped, which are not named")
            return
        self._pictures[index] = picture
        self._state[index] = READY  # last: another process that sees it finds the picture

    def _fingerprint(self) -> str:
        digest = hashlib.sha256(json.dumps(asdict(self.preprocessing), sort_keys=True).encode())
        for frame in self.frames:
            path = frame.image_path(self.camera)
            status = path.stat() if path is not None and path.exists() else None
            size = () if status is None else (status.st_size, status.st_mtime_ns)
            digest.update(f"{frame.label}:{path}:{size}".encode())
        return digest.hexdigest()[:16]


class ReadableItems(Protocol):
    """Items to learn from and to validate with, of which some may have a damaged image."""

    training_items: NDArray[np.int64]
    validation_items: NDArray[np.int64]

    @property
    def damaged(self) -> list[str]:
        """Names of the frames whose image could not be read so far."""

    def healthy(self, items: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Reads what has not been read yet of frames (indices of any shape); returns whether each can be used."""


def replace_unreadable(
    objective: ReadableItems, items: NDArray[np.int64], generator: np.random.Generator | None
) -> NDArray[np.int64]:
    """Returns items whose images can be read.

    Args:
        generator: draws others in place of those with a damaged image; None: they are left out.

    Raises:
        ValueError: too few images can be read.
    """
    good = objective.healthy(items)
    if good.all():
        return items
    if generator is None and good.any():
        return items[good]
    pool = objective.training_items if generator is not None else objective.validation_items
    generator = generator or np.random.default_rng(0)
    chosen = items.copy()
    for place in np.flatnonzero(~good):
        for _ in range(_DRAWS):
            other = generator.choice(pool)
            if objective.healthy(np.array([other])).all():
                chosen[place] = other
                break
        else:
            damaged = objective.damaged
            raise ValueError(
                f"{len(damaged)} images cannot be read, the first of frame {damaged[0]}: "
                "there are too few others to train with"
            )
    return chosen


def _shared(path: Path, count: int, size_px: int) -> NDArray[np.uint8]:
    """States, then pictures, in a file of zeros that processes share; made if it is not there or has another size."""
    path.parent.mkdir(parents=True, exist_ok=True)
    size = count * (1 + size_px**2)
    if not path.is_file() or path.stat().st_size != size:
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        temporary.unlink(missing_ok=True)  # a link of that name would be written through
        with temporary.open("wb") as file:
            file.truncate(size)  # sparse: takes no disk space until it is written
        os.replace(temporary, path)
    return np.memmap(path, np.uint8, "r+", shape=(size,))
