"""A cache of small images: area-averaged once, kept as one array on disk, filled on after an interruption."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from guide3d.dataset.frame import Frame, ImageError

__all__ = ["cached_pictures"]

_LOGGER = logging.getLogger(__name__)


def cached_pictures(
    frames: Sequence[Frame], camera: str, size_px: int, folder: Path
) -> np.memmap[Any, np.dtype[np.uint8]]:
    """Small versions of all images of a camera, from the cache or made now.

    A file of one byte an image beside the array says which rows are done, so that an interrupted call goes on. Its name
    holds a hash over the images' paths, sizes and times: other images never meet an old cache.

    Args:
        frames: of the data set.
        camera: "a" or "b".
        size_px: side.
        folder: of the cache.

    Returns:
        (frames, size_px, size_px) uint8, read only; zeros where an image cannot be read.

    Raises:
        ValueError: a size below 1.
        ImageError: not one image can be read.
    """
    if size_px < 1:
        raise ValueError(f"size_px: expected at least 1, got {size_px}")
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"pictures-{camera}-{size_px}-{_fingerprint(frames, camera)}"
    data, done = folder / f"{stem}.npy", folder / f"{stem}.done"
    shape = (len(frames), size_px, size_px)
    if not (data.exists() and done.exists() and done.stat().st_size == len(frames)):
        done.unlink(missing_ok=True)
        np.lib.format.open_memmap(data, "w+", np.uint8, shape).flush()
        done.write_bytes(bytes(len(frames)))
    state = np.memmap(done, np.uint8, "r+", shape=(len(frames),))
    pixels = np.lib.format.open_memmap(data, "r+")
    for row in np.flatnonzero(state == 0).tolist():
        try:
            image = Image.fromarray(frames[row].image(camera))
        except ImageError as error:
            _LOGGER.warning("left out: %s", error)
            state[row] = 2
            continue
        small = image if image.size == (size_px, size_px) else image.resize((size_px, size_px), Image.Resampling.BOX)
        pixels[row] = np.asarray(small)
        state[row] = 1
    pixels.flush()
    state.flush()
    if len(frames) and not (state == 1).any():
        raise ImageError(f"not one image of camera {camera.upper()} can be read, {frames[0].label} the first of them")
    del pixels
    return np.lib.format.open_memmap(data, "r")


def _fingerprint(frames: Sequence[Frame], camera: str) -> str:
    digest = hashlib.sha256()
    for frame in frames:
        path = frame.image_path(camera)
        text = f"{frame.label}:{path}"
        if path is not None and path.exists():
            status = path.stat()
            text += f":{status.st_size}:{status.st_mtime_ns}"
        digest.update(text.encode())
    return digest.hexdigest()[:16]
