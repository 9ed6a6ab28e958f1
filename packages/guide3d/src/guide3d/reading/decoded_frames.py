"""Films and TIFFs of several pages, decoded by a child process into a temporary file, of which memory holds a frame."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.guarded_reading import call_in_child, check_regular, open_regular
from guide3d.image_file import ImageError, words_printed
from guide3d.opencv import cv2

_LARGEST_PX = 8192  # of a frame's side
_MOST_BYTES = 16 << 30  # of all frames
_SECONDS = 600.0
_QUICKTIME = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # the first box of .mp4 and .mov

Frame = NDArray[np.generic]
Decoder = Callable[[Path, int | None], Generator[Frame, None, tuple[Any, ...]]]  # fields of `Decoded` after the first


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


def decoded_frames(path: Path, decoder: Decoder, most: int | None = None) -> Generator[Frame, None, Decoded]:
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


def film_frames(path: Path, most: int | None = None) -> Generator[Frame, None, tuple[int, list[str], float]]:
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
