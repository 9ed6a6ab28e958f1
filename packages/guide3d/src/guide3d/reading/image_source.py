"""Images as users have them, to arrays: picture files, folders of them, films (read by a child process), DICOM runs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from guide3d.files import files_in
from guide3d.geometry.camera import Camera
from guide3d.guarded_reading import call_in_child, check_regular, open_regular
from guide3d.image_file import PICTURES, ImageError, is_tiff, read_picture, tiff_pages, words_printed
from guide3d.opencv import cv2

if TYPE_CHECKING:
    from guide3d.dicom.xray_run import XrayRun

FILMS = (".mp4", ".m4v", ".avi", ".mov", ".mkv", ".webm")
DICOM = (".dcm", ".dicom", ".ima")
_LARGEST_PX = 8192  # of a frame's side
_MOST_BYTES = 16 << 30  # of all frames
_SECONDS = 600.0
_QUICKTIME = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # the first box of .mp4 and .mov

Image = NDArray[np.generic]
Decoder = Callable[[Path, int | None], Generator[Image, None, tuple[Any, ...]]]  # fields of `Decoded` after the first


@dataclass(frozen=True)
class Decoded:
    """What became of a file.

    kinds: of each frame, its number type and shape
    count: how many frames the file says to have
    notes: what is to be said about them, as sentences
    rate: frames a second, 0 where the file does not say
    """

    kinds: list[tuple[str, tuple[int, ...]]]
    count: int
    notes: list[str]
    rate: float = 0.0


def decoded_frames(path: Path, decoder: Decoder, most: int | None = None) -> Generator[Image, None, Decoded]:
    """Decodes a file in a child process and yields its frames, at most some of them.

    Returns:
        What became of it.

    Raises:
        ValueError: it cannot be read, or takes too much time, memory or disk.
    """
    check_regular(path)
    with tempfile.TemporaryDirectory(prefix="guide3d.") as folder:
        store = Path(folder) / "frames"
        decoded = call_in_child(_store, path, decoder, store, most, subject=str(path), seconds=_SECONDS)
        with store.open("rb") as file:
            for kind, shape in decoded.kinds:
                yield np.fromfile(file, kind, int(np.prod(shape))).reshape(shape)
    return decoded


def film_frames(path: Path, most: int | None = None) -> Generator[Image, None, tuple[int, list[str], float]]:
    """Reads a film by OpenCV as grey frames (h, w); at most some of them. To be called in a child process."""
    with open_regular(path) as file:
        mark = file.read(12)
    # a list of other files, which FFmpeg would follow, is no film
    known = mark.startswith((b"RIFF", b"\x1aE\xdf\xa3")) or mark[4:8] in _QUICKTIME
    film = cv2.VideoCapture(str(path)) if known else None
    if film is None or not film.isOpened():
        raise ImageError(f"film {path} cannot be read: it is damaged, or no film")
    film.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # frames as they were recorded, as pictures are read
    turn, rate = film.get(cv2.CAP_PROP_ORIENTATION_META), film.get(cv2.CAP_PROP_FPS)
    promised = film.get(cv2.CAP_PROP_FRAME_COUNT)
    width, height = film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if max(width, height) > _LARGEST_PX:
        raise ImageError(f"film {path} cannot be read: it claims frames of {width:g} x {height:g} px")
    count = 0
    with words_printed() as words:  # around all frames: FFmpeg's threads tell of the next ones early
        while most is None or count < most:
            decoded, frame = film.read()
            if not decoded:
                break
            count += 1
            yield np.asarray(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
        film.release()
    if not count:
        raise ImageError(f"film {path} holds no frame")
    notes = [f"{path.name}: a turn by {turn:g} degrees, which its header asks for, is not made"] if turn else []
    if most is None and count < promised < 1e9:  # of which FFmpeg speaks, too
        notes.append(
            f"{path.name}: its header promises {promised:.0f} frames, {count} of them are there: the film is cut off"
        )
    elif words:  # FFmpeg speaks of errors only
        notes.append(f"{path.name}: it is damaged: some frames show what its decoder filled up")
    return (int(promised) if most is not None and 0 < promised < 1e9 else count), notes, rate


def _store(path: Path, decoder: Decoder, store: Path, most: int | None) -> Decoded:
    kinds: list[tuple[str, tuple[int, ...]]] = []
    written = 0
    with store.open("wb") as file:
        frames = decoder(path, most)
        while True:
            try:
                frame = next(frames)
            except StopIteration as end:
                return Decoded(kinds, *end.value)
            kinds.append((frame.dtype.str, frame.shape))
            written += frame.nbytes
            if written > _MOST_BYTES:
                raise ImageError(f"{path} holds more than {_MOST_BYTES >> 30} GB of frames: cut it into parts")
            file.write(np.ascontiguousarray(frame).data)


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
        from guide3d.dicom.run_folder import read_xray

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
