"""Images as users have them: picture files, folders of them, films and DICOM runs, to arrays."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from guide3d.files import files_in
from guide3d.geometry.camera import Camera
from guide3d.image_file import PICTURES, ImageError, is_tiff, read_picture, tiff_pages
from guide3d.reading.decoded_frames import decoded_frames, film_frames

if TYPE_CHECKING:
    from guide3d.dicom.xray_run import XrayRun

FILMS = (".mp4", ".m4v", ".avi", ".mov", ".mkv", ".webm")
DICOM = (".dcm", ".dicom", ".ima")

Image = NDArray[np.generic]


class Source:
    """Where images come from.

    Attributes:
        path: a picture, a TIFF of several pages, a DICOM run, a film, or a folder: of pictures, in the order of the
            numbers in their names, or of single DICOM files of one run.
        count: how many images it has, known once an image was read.
        notes: what is to be said about them, as sentences; complete once all were read.
        rate: frames a second of a film that says so, once all were read; 0 of others.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self.notes: list[str] = []
        self.rate = 0.0

    def is_dicom(self) -> bool:
        """Whether it is a DICOM file or a folder of them, by names or by the mark."""
        if self.path.is_dir():
            return not self._pictures and bool(files_in(self.path, "*"))
        if self.path.suffix.lower() in DICOM:
            return True
        if not self.path.is_file() or self.path.suffix.lower() in (*PICTURES, *FILMS):
            return False
        with self.path.open("rb") as file:
            start = file.read(132)
        return start[128:] == b"DICM" or start[:2] in (b"\x02\0", b"\x08\0")  # without a preamble: the first group

    def first(self) -> Image:
        """Its only or first image.

        Raises:
            ValueError: it cannot be read; the message is one sentence.
        """
        (image,) = self.images(1)  # to its end, where the count is known
        return image

    def images(self, most: int | None = None) -> Iterator[Image]:
        """Its images in order, (h, w) or (h, w, 3), one at a time; at most some of them.

        Raises:
            ValueError: it cannot be read, or holds no image.
        """
        if self.is_dicom():
            self.count = len(self.run)
            for frame in range(self.count)[:most]:
                yield self.run.image(frame)
        elif self.path.is_dir():
            if not self._pictures:
                raise ImageError(f"folder {self.path} holds no pictures ({', '.join(PICTURES)}) and no DICOM files")
            self.count = len(self._pictures)
            runs = files_in(self.path, *(f"*{ending}" for ending in DICOM))
            if runs:
                self._note(f"{self.path.name}: its pictures were read, its {len(runs)} DICOM files were not")
            first: tuple[int, ...] = ()
            for file in self._pictures[:most]:
                picture = read_picture(file)
                first = first or picture.shape[1::-1]
                if picture.shape[1::-1] != first:
                    sizes = [" x ".join(map(str, size)) for size in (picture.shape[1::-1], first)]
                    self._note(f"{file} has {sizes[0]} px, the first picture of its folder {sizes[1]} px")
                yield picture
        elif self.path.suffix.lower() in FILMS or is_tiff(self.path):
            if not self.path.exists():
                raise ImageError(f"{'image' if is_tiff(self.path) else 'film'} {self.path} is missing: check its path")
            decoded = yield from decoded_frames(self.path, tiff_pages if is_tiff(self.path) else film_frames, most)
            self.count, self.rate = decoded.count, decoded.rate
            self._note(*decoded.notes)
        else:
            self.count = 1
            yield read_picture(self.path)

    @cached_property
    def run(self) -> XrayRun:
        """The DICOM run.

        Raises:
            ValueError: it cannot be read.
        """
        from guide3d.dicom import read_xray

        run = read_xray(self.path)
        self._note(*(f"{self.path.name}: {warning}" for warning in run.warnings))
        return run

    @cached_property
    def _pictures(self) -> list[Path]:
        return files_in(self.path, *(f"*{ending}" for ending in PICTURES))

    def _note(self, *sentences: str) -> None:
        self.notes += [sentence for sentence in sentences if sentence not in self.notes]


def dicom_cameras(a: Source, b: Source) -> tuple[Camera, Camera]:
    """Cameras of the first frames of two DICOM runs.

    Raises:
        ValueError: what a camera needs is missing in a file.
    """
    from guide3d.dicom.pair import paired

    pair = paired(a.run, b.run)
    a.notes += [warning for warning in pair.warnings if warning not in a.notes + b.notes]
    return pair.cameras_a[0], pair.cameras_b[0]
