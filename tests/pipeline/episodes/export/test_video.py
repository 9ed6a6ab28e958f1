"""The mp4 film: its pictures come back within a few grey values, at even and odd sizes."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from pipeline.episodes.export.video import GreyVideo


@pytest.mark.parametrize(("size", "stored"), [((48, 64), "yuv420p"), ((47, 65), "yuv444p")])
def test_pictures_come_back(size: tuple[int, int], stored: str, tmp_path: Path) -> None:
    rows, columns = np.indices(size)
    pictures = [((rows * 3 + columns * 2 + 40 * index) % 200 + 30).astype(np.uint8) for index in range(9)]
    film = GreyVideo(tmp_path / "deep" / "a.mp4", size, 7.5)
    for picture in pictures:
        film.add(picture)
    film.close()
    film.close()
    assert film.written_bytes == (tmp_path / "deep" / "a.mp4").stat().st_size
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "deep" / "a.mp4"), pix_fmt="gray", bits_per_pixel=8)
    meta = next(frames)
    assert meta["fps"] == 7.5
    assert meta["pix_fmt"].startswith(stored)
    found = [np.frombuffer(frame, np.uint8).reshape(size) for frame in frames]
    assert len(found) == len(pictures)
    for one, picture in zip(found, pictures, strict=True):
        assert np.abs(one.astype(int) - picture).mean() < 3


def test_a_film_of_which_nothing_is_written_yet_has_no_size(tmp_path: Path) -> None:
    film = GreyVideo(tmp_path / "a.mp4", (48, 64), 7.5)
    film.path = tmp_path / "later.mp4"
    assert film.written_bytes == 0
    film.add(np.zeros((48, 64), np.uint8))
    film.close()
