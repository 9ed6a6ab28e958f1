"""Images as users have them: picture files, folders of them, films and DICOM runs, to arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.camera import Camera
from guide3d.image_file import ImageError, read_grey_levels
from guide3d.opencv import cv2

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
FILMS = (".mp4", ".avi", ".mov", ".mkv")
DICOM = (".dcm", ".dicom", ".ima")

Image = NDArray[np.generic]


@dataclass(frozen=True, eq=False)
class Source:
    """Where images come from.

    path: a picture, a DICOM run, a film, or a folder of pictures, which are taken by name
    """

    path: Path

    def is_dicom(self) -> bool:
        """Whether it is a DICOM file, by its name or its mark."""
        if self.path.suffix.lower() in DICOM:
            return True
        if not self.path.is_file():
            return False
        with self.path.open("rb") as file:
            return file.read(132)[128:] == b"DICM"

    def first(self) -> Image:
        """Its only or first image.

        Raises:
            ValueError: it cannot be read; the message is one sentence.
        """
        return next(self.images())

    def images(self) -> Iterator[Image]:
        """Its images in order, (h, w) or (h, w, 3), one at a time.

        Raises:
            ValueError: it cannot be read, or holds no image.
        """
        suffix = self.path.suffix.lower()
        if self.path.is_dir():
            names = sorted(file for file in self.path.iterdir() if file.suffix.lower() in PICTURES)
            if not names:
                raise ImageError(f"folder {self.path} holds no pictures ({', '.join(PICTURES)})")
            for file in names:
                yield read_picture(file)
        elif suffix in FILMS:
            yield from _film(self.path)
        elif self.is_dicom():
            from guide3d.dicom import read_xray

            yield from read_xray(self.path).images()
        else:
            yield read_picture(self.path)


def read_picture(path: Path) -> Image:
    """Reads a picture: (h, w) grey levels of 8 or 16 bits, or (h, w, 3) RGB where it has colours.

    Raises:
        ImageError: it is missing, damaged or no picture.
    """
    grey = read_grey_levels(path)
    if grey.dtype == np.uint8:
        data = np.frombuffer(path.read_bytes(), np.uint8)
        colour = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
        if colour is not None and np.ptp(colour[::4, ::4].astype(np.int16), axis=2).any():
            return np.asarray(colour)
    return grey


def dicom_cameras(a: Source, b: Source) -> tuple[Camera, Camera]:
    """Cameras of the first frames of two DICOM runs.

    Raises:
        ValueError: what a camera needs is missing in a file.
    """
    from guide3d.dicom import images_and_cameras

    pair = images_and_cameras(a.path, b.path)
    return pair.cameras_a[0], pair.cameras_b[0]


def _film(path: Path) -> Iterator[Image]:
    film = cv2.VideoCapture(str(path)) if path.is_file() else None
    if film is None or not film.isOpened():
        raise ImageError(f"film {path} is missing" if film is None else f"film {path} cannot be read")
    count = 0
    try:
        while True:
            there, frame = film.read()
            if not there:
                break
            count += 1
            yield np.asarray(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
    finally:
        film.release()
    if not count:
        raise ImageError(f"film {path} holds no frame")
