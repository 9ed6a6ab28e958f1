"""Image files: kinds and depths, what is damaged or cut off, and pictures that come back as written."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from guide3d.image_file import ImageError, eight_bits, encode_png, read_grey_levels, write_png
from guide3d.opencv import cv2

GREY = np.random.default_rng(0).integers(0, 256, (40, 56), np.uint8)


@pytest.mark.parametrize("ending", [".png", ".tif", ".bmp"])
def test_grey_images_come_back(ending: str, tmp_path: Path) -> None:
    Image.fromarray(GREY).save(tmp_path / f"grey{ending}")
    read = read_grey_levels(tmp_path / f"grey{ending}")
    assert read.dtype == np.uint8
    assert np.array_equal(read, GREY)


@pytest.mark.parametrize("mode", ["1", "LA", "P", "RGB", "RGBA"])
def test_other_kinds_are_the_grey_that_pillow_makes_of_them(mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    colours = Image.fromarray(rng.integers(0, 256, (40, 56, 3), np.uint8)).convert(mode)
    colours.save(tmp_path / "picture.png")
    expected = np.asarray(colours.convert("RGB").convert("L"), int)
    assert np.abs(read_grey_levels(tmp_path / "picture.png").astype(int) - expected).max() <= 1


@pytest.mark.parametrize("ending", [".png", ".tif"])
def test_deep_images_keep_their_depth(ending: str, tmp_path: Path) -> None:
    deep = GREY.astype(np.uint16) * 257
    Image.fromarray(deep).save(tmp_path / f"deep{ending}")
    read = read_grey_levels(tmp_path / f"deep{ending}")
    assert read.dtype == np.uint16
    assert np.array_equal(read, deep)
    assert np.array_equal(eight_bits(read), GREY)
    assert eight_bits(GREY).dtype == np.uint8


def test_written_pictures_are_red_green_blue(tmp_path: Path) -> None:
    colours = np.random.default_rng(2).integers(0, 256, (20, 30, 3), np.uint8)
    write_png(colours, tmp_path / "new" / "colours.png")
    with Image.open(tmp_path / "new" / "colours.png") as picture:
        assert np.array_equal(np.asarray(picture), colours)
    assert np.array_equal(cv2.imdecode(np.frombuffer(encode_png(GREY), np.uint8), cv2.IMREAD_UNCHANGED), GREY)


@pytest.mark.parametrize("ending", [".png", ".jpg", ".tif"])
def test_cut_off_images_are_refused_in_one_sentence(
    ending: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"image{ending}"
    Image.fromarray(GREY).save(path)
    whole = path.read_bytes()
    for length in range(0, len(whole) - 1, 13):
        path.write_bytes(whole[:length])
        with pytest.raises(ImageError, match=rf"^image {path} cannot be read: it is [a-z ,]+$"):
            read_grey_levels(path)
    if ending != ".tif":
        assert capfd.readouterr().err == ""  # no decoder said a word of its own


def test_damaged_pngs_are_refused_without_another_word(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = encode_png(GREY)
    for bit in np.random.default_rng(3).integers(0, 8 * len(whole), 200).tolist():
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        (tmp_path / "image.png").write_bytes(damaged)
        with pytest.raises(ImageError, match="cannot be read"):
            read_grey_levels(tmp_path / "image.png")
    assert capfd.readouterr().err == ""


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("no image")
    huge = bytearray(encode_png(GREY))
    huge[16:24] = (100_000).to_bytes(4, "big") * 2
    huge[29:33] = zlib.crc32(huge[12:29]).to_bytes(4, "big")
    (tmp_path / "huge.png").write_bytes(huge)
    for name, said in (
        ("empty.png", "it is empty"),
        ("text.png", "it is damaged, or no image"),
        ("huge.png", "it claims 100000 x 100000 px"),
        ("none.png", "is missing"),
        ("", "cannot be read: Is a directory"),
    ):
        with pytest.raises(ImageError, match=said):
            read_grey_levels(tmp_path / name)
