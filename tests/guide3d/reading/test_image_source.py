"""Where images come from: folders, films, TIFFs of several pages, DICOM runs; what is missing in them is said."""

import os
from pathlib import Path

import numpy as np
import pytest
import tifffile

from guide3d.image_file import write_png
from guide3d.opencv import cv2
from guide3d.reading.image_source import Source

RAMP = np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (64, 1))


def film(path: Path, count: int, code: str = "MJPG") -> Path:
    """A film of even grey frames, each 10 levels brighter than the one before."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 10, (64, 64))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no films")
    for k in range(count):
        writer.write(np.full((64, 64, 3), 10 * k, np.uint8))
    writer.release()
    return path


def test_unpadded_numbers_give_the_order(tmp_path: Path) -> None:
    for k in range(1, 13):
        write_png(np.full((64, 64), 20 * k, np.uint8), tmp_path / f"{k}.{'PNG' if k % 2 else 'png'}")
    (tmp_path / "._1.png").write_bytes(b"\0\5\x16\7")  # what macOS leaves on other disks
    (tmp_path / "1.dcm").write_bytes(b"x")
    source = Source(tmp_path)
    assert [int(image[0, 0]) for image in source.images()] == [20 * k for k in range(1, 13)]
    assert source.first()[0, 0] == 20
    assert source.count == 12
    assert source.notes == [f"{tmp_path.name}: its pictures were read, its 1 DICOM files were not"]
    assert not source.is_dicom()


@pytest.mark.parametrize("name", ["film.avi FFV1", "film.mkv mp4v", "film.webm VP80", "film.MOV mp4v"])
def test_whole_films_are_read_without_a_word(name: str, tmp_path: Path) -> None:
    source = Source(film(tmp_path / name.split()[0], 20, name.split()[1]))
    images = list(source.images())
    assert np.abs([image.mean() - 10 * k for k, image in enumerate(images)]).max() < 4
    assert (len(images), source.count, source.notes) == (20, 20, [])
    assert source.first().shape == (64, 64)
    assert source.count == 20


def test_films_that_promise_more_frames_say_both_numbers(tmp_path: Path) -> None:
    whole = film(tmp_path / "whole.avi", 20).read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) * 6 // 10])
    source = Source(tmp_path / "cut.avi")
    count = len(list(source.images()))
    assert 0 < count < 20
    assert source.count == count
    assert f"cut.avi: its header promises 20 frames, {count} of them are there" in source.notes[0]


@pytest.mark.parametrize("code", ["MJPG", "mp4v"])
def test_films_whose_decoder_fills_up_what_is_missing_say_so(code: str, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "noise.avi"), cv2.VideoWriter.fourcc(*code), 10, (64, 64))
    for image in np.random.default_rng(0).integers(0, 256, (9, 64, 64, 3), np.uint8):
        writer.write(image)
    writer.release()
    whole = (tmp_path / "noise.avi").read_bytes()
    (tmp_path / "noise.avi").write_bytes(whole[: len(whole) // 2] + bytes(60) + whole[len(whole) // 2 + 60 :])
    source = Source(tmp_path / "noise.avi")
    assert len(list(source.images())) == 9
    assert source.notes == ["noise.avi: it is damaged: some frames show what its decoder filled up"]


def test_pages_of_a_tiff_are_frames(tmp_path: Path) -> None:
    pages = [RAMP, RAMP[::-1], RAMP.T]
    cv2.imwritemulti(str(tmp_path / "three.tif"), pages)
    source = Source(tmp_path / "three.tif")
    assert np.array_equal(list(source.images()), pages)
    assert np.array_equal(source.first(), RAMP)
    assert (source.count, source.notes) == (3, [])
    with tifffile.TiffWriter(tmp_path / "other.tif") as file:
        for page in (RAMP, RAMP[:20], RAMP.T.astype(np.uint8)):
            file.write(page)
    source = Source(tmp_path / "other.tif")
    assert len(list(source.images())) == 2
    assert source.notes == ["other.tif: 1 pages of another size were left out"]


def test_what_is_no_film_is_one_sentence(tmp_path: Path) -> None:
    film(tmp_path / "real.avi", 2)
    os.mkfifo(tmp_path / "pipe.avi")
    (tmp_path / "text.mp4").write_text("no film")
    (tmp_path / "list.avi").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nreal.avi\n")
    (tmp_path / "parts.mkv").write_text(f"ffconcat version 1.0\nfile {tmp_path}/real.avi\n")
    (tmp_path / "dark.mp4").write_bytes(b"\0\0\0\x20ftypisom" + bytes(100))
    for name, said in (
        ("pipe.avi", "is no regular file"), ("text.mp4", "no film"), ("list.avi", "no film"), ("parts.mkv", "no film"),
        ("dark.mp4", "no film"), ("none.avi", "is missing"), ("none.tif", "is missing"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            list(Source(tmp_path / name).images())


def test_folders_of_dicom_frames_are_a_run(tmp_path: Path) -> None:
    pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")
    from tests.guide3d.dicom.written_xray import frames_of, write, xray_dataset

    frames = frames_of(11)
    for k, frame in enumerate(frames):
        changed = {"NumberOfFrames": None, "InstanceNumber": str(11 - k), "SeriesInstanceUID": "1.2"}
        write(xray_dataset(frame[None], **changed), tmp_path / f"IM{k}")
    source = Source(tmp_path)
    assert source.is_dicom()
    assert np.array_equal(list(source.images()), frames[::-1])
    assert (source.count, source.notes) == (11, [])
    (tmp_path / "IM3").write_bytes((tmp_path / "IM3").read_bytes()[132:])
    assert Source(tmp_path / "IM3").is_dicom()
    assert np.array_equal(Source(tmp_path / "IM3").first(), frames[3])
    (tmp_path / "none").mkdir()
    with pytest.raises(ValueError, match=r"holds no pictures .* and no DICOM files"):
        Source(tmp_path / "none").first()
