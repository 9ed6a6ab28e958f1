"""Reads sequences of images, each with the help of the one before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import Distortion
from guide3d.reading.curve_reading import Prior
from guide3d.reading.image_reading import ImageReading, MapReader, read
from guide3d.reading.pair_reading import PairReading, PairReadingSettings, read_pair

Image = NDArray[np.generic]


@dataclass(frozen=True, eq=False)
class FrameReading:
    """A frame of a sequence: its reading, or why there is none."""

    reading: ImageReading | PairReading | None
    said: str = ""


def read_sequence(images: Iterable[Image], reader: MapReader | None = None) -> Iterator[FrameReading]:
    """Reads the images of one view, in order; a frame that cannot be read leaves the others alone."""
    prior: Prior | None = None
    for image in images:
        try:
            reading = read(image, reader, prior)
        except ValueError as error:
            yield FrameReading(None, str(error))
            continue
        if reading.found:
            prior = Prior(reading.points_px)
        yield FrameReading(reading)


def read_pairs(
    images_a: Iterable[Image],
    images_b: Iterable[Image],
    cameras: Sequence[Camera],
    distortions: Sequence[Distortion] | None = None,
    frame: str = "auto",
    reader: MapReader | None = None,
    settings: PairReadingSettings | None = None,
) -> Iterator[FrameReading]:
    """Reads pairs of images, in order, as `read_pair`; a frame without its partner is given, but not read."""
    priors: list[Prior | None] = [None, None]
    for a, b in zip_longest(images_a, images_b):
        if a is None or b is None:
            yield FrameReading(None, f"there is no image of camera {'A' if a is None else 'B'} at this moment")
            continue
        try:
            reading = read_pair(a, b, cameras, distortions, frame, reader, priors, settings)
        except ValueError as error:
            yield FrameReading(None, str(error))
            continue
        if reading.accepted:
            priors = [Prior(view.points_px) for view in reading.views]
        yield FrameReading(reading)
