"""Files of images and texts: values kept, damage refused in one sentence; filters against SciPy's."""

import codecs
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy import ndimage

from guide3d.dataset.frame import eight_bits
from guide3d.files import numbers_in, read_json, read_text
from guide3d.image_file import (
    ImageError,
    encode_png,
    read_grey_levels,
    read_picture,
    tiff_pages,
    write_png,
)
from guide3d.image_filters import sampled
from guide3d.opencv import cv2

GREY = np.random.default_rng(0).integers(0, 256, (40, 56), np.uint8)


@pytest.mark.parametrize("mode", ["1", "LA", "P", "RGB", "RGBA"])
def test_other_kinds_are_the_grey_that_pillow_makes_of_them(mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    colours = Image.fromarray(rng.integers(0, 256, (40, 56, 3), np.uint8)).convert(mode)
    colours.save(tmp_path / "picture.png")
    expected = np.asarray(colours.convert("RGB").convert("L"), int)
    assert np.abs(read_grey_levels(tmp_path / "picture.png").astype(int) - expected).max() <= 1


@pytest.mark.parametrize(
    ("ending", "levels"),
    [
        *((ending, GREY) for ending in (".png", ".tif", ".bmp")),
        *((e, 257 * GREY.astype(np.uint16)) for e in (".png", ".tif")),
    ],
)
def test_grey_images_come_back_in_their_depth(ending: str, levels: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(levels).save(tmp_path / f"grey{ending}")
    read = read_grey_levels(tmp_path / f"grey{ending}")
    assert read.dtype == levels.dtype
    assert np.array_equal(read, levels)
    assert eight_bits(read).dtype == np.uint8
    assert np.array_equal(eight_bits(read), GREY)


def test_images_of_12_bits_in_16_are_refused() -> None:
    with pytest.raises(ImageError, match="end at 4080 of 65535"):
        eight_bits(np.full((4, 4), 4080, np.uint16))


@pytest.mark.parametrize("kind", ["float16", "float64", "int16", "int32", "uint32"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiffs_of_other_numbers_keep_their_values(kind: str, compression: str | None, tmp_path: Path) -> None:
    levels = (GREY.astype(float) - (100 if kind.startswith("i") else 0)).astype(kind)
    tifffile.imwrite(tmp_path / "image.tif", levels, compression=compression)
    read = read_grey_levels(tmp_path / "image.tif")
    assert read.dtype == np.float32
    assert np.array_equal(read, levels)
    for planes, axis in (("contig", -1), ("separate", 0)):
        samples, transparent = np.stack([levels, levels[::-1]], axis), ["unassalpha"]
        tifffile.imwrite(tmp_path / "image.tif", samples, photometric="minisblack", planarconfig=planes,
                         compression=compression, extrasamples=transparent)  # fmt: skip
        assert np.array_equal(read_grey_levels(tmp_path / "image.tif"), levels)


def test_float_images_of_opencv_and_pillow(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "opencv.tif"), GREY.astype(np.float32))
    Image.fromarray(GREY.astype(np.float32)).save(tmp_path / "pillow.tif")
    for name in ("opencv", "pillow"):
        read = read_grey_levels(tmp_path / f"{name}.tif")
        assert np.array_equal(read, GREY)
        assert np.array_equal(eight_bits(read), GREY)
        assert np.array_equal(eight_bits(read / 255), GREY)
    with pytest.raises(ImageError, match="expected grey values from 0 to 1, 255 or 65535, found -3 to"):
        eight_bits(read - read.min() - 3)
    tifffile.imwrite(tmp_path / "nan.tif", np.where(GREY > 9, GREY, np.nan).astype(np.float32))
    with pytest.raises(ImageError, match="no finite numbers"):
        read_grey_levels(tmp_path / "nan.tif")


@pytest.mark.parametrize("bits", [8, 12, 16, 32])
def test_tiffs_whose_white_is_zero_are_inverted(bits: int, tmp_path: Path) -> None:
    top = 1.0 if bits == 32 else 2**bits - 1
    levels = np.round(GREY / 255 * top, 0 if bits < 32 else 9)
    levels[0, 0], levels[0, 1] = 0, top
    stored = (top - levels).astype({8: np.uint8, 32: np.float32}.get(bits, np.uint16))
    tifffile.imwrite(tmp_path / "image.tif", stored, photometric="miniswhite")
    assert np.allclose(read_grey_levels(tmp_path / "image.tif"), levels, atol=1e-6)


def test_pages_are_a_film_and_no_image(tmp_path: Path) -> None:
    pages = [GREY, GREY[::-1], GREY[:, ::-1]]
    cv2.imwritemulti(str(tmp_path / "opencv.tif"), pages)
    Image.fromarray(pages[0]).save(
        tmp_path / "pillow.tif", save_all=True, append_images=[Image.fromarray(page) for page in pages[1:]]
    )
    tifffile.imwrite(tmp_path / "tifffile.tif", np.stack(pages), photometric="minisblack", bigtiff=True)
    tifffile.imwrite(tmp_path / "imagej.tif", np.stack(pages), imagej=True)
    for name in ("opencv", "pillow", "tifffile", "imagej"):
        with pytest.raises(ImageError, match=f"{name}.tif holds 3 pages: save the one that is meant"):
            read_grey_levels(tmp_path / f"{name}.tif")
        assert np.array_equal(list(tiff_pages(tmp_path / f"{name}.tif")), pages)
    tifffile.imwrite(tmp_path / "volume.tif", np.stack(pages), photometric="minisblack", volumetric=True)
    with pytest.raises(ImageError, match=r"volume.tif cannot be read: it is a volume of 3 layers; save them as pages"):
        read_grey_levels(tmp_path / "volume.tif")


def test_pages_of_other_sizes_count(tmp_path: Path) -> None:
    path = tmp_path / "image.tif"
    Image.fromarray(GREY[:20]).save(path, save_all=True, append_images=[Image.fromarray(GREY)])
    with pytest.raises(ImageError, match=r"image.tif holds 2 pages: save the one that is meant"):
        read_grey_levels(path)


@pytest.mark.parametrize("kinds", [(0, 1), (1, 0), (1, 0, 1), (4, 0), (1,)])
def test_previews_and_masks_are_no_pages(kinds: tuple[int, ...], tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "image.tif") as file:
        for kind in kinds:
            page = GREY if kind == 0 or len(kinds) == 1 else GREY[::4, ::4]
            file.write(page > 99 if kind == 4 else page, subfiletype=kind)
    assert np.array_equal(read_grey_levels(tmp_path / "image.tif"), GREY)
    assert np.array_equal(list(tiff_pages(tmp_path / "image.tif")), [GREY])


@pytest.mark.parametrize("orientation", range(2, 9))
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_the_turn_that_a_tiff_asks_for_is_not_made(orientation: int, kind: type, tmp_path: Path) -> None:
    path, levels = tmp_path / "image.tif", GREY.astype(kind)
    tags = [(274, "H", 1, orientation, True)]
    for more in ({}, {"byteorder": ">"}, {"bigtiff": True}, {"compression": "zlib"}):
        tifffile.imwrite(path, np.stack([levels, levels[::-1]]), photometric="minisblack", extratags=tags, **more)
        assert np.array_equal(list(tiff_pages(path)), [levels, levels[::-1]])
    if kind != np.float32:
        Image.fromarray(levels).save(path, compression="tiff_lzw", tiffinfo={274: orientation})
        assert np.array_equal(read_grey_levels(path), levels)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("transparent", [None, "unassalpha", "assocalpha", "unspecified"])
@pytest.mark.parametrize("more", [{}, {"compression": "zlib"}, {"byteorder": ">"}, {"tile": (32, 32)}])
def test_planes_and_transparency_of_tiffs(
    bits: int, transparent: str | None, more: dict[str, Any], tmp_path: Path
) -> None:
    """Colours are the same grey however they are stored, grey keeps its depth, and what is transparent its light."""
    path, kind = tmp_path / "image.tif", np.uint8 if bits == 8 else np.uint16
    colours = np.random.default_rng(1).integers(0, 2**bits, (40, 56, 3)).astype(kind)
    if bits == 16:
        colours[0, 0] = 1000, 20_000, 50_000
    tifffile.imwrite(path, colours, photometric="rgb")
    grey_of_colours = read_grey_levels(path)
    assert bits == 8 or grey_of_colours[0, 0] == 17_739
    for photometric, samples, grey in (
        ("rgb", colours, grey_of_colours),
        ("minisblack", colours[..., :1], colours[..., 0]),
        ("miniswhite", ~colours[..., :1], colours[..., 0]),
    ):
        if transparent:
            samples = np.concatenate([samples, colours[..., 1:2] // 2], -1)
            more = {**more, "extrasamples": [transparent]}
        for planes in ("contig", "separate") if samples.shape[-1] > 1 else ():
            stored = samples if planes == "contig" else np.moveaxis(samples, -1, 0)
            tifffile.imwrite(path, stored, photometric=photometric, planarconfig=planes, **more)
            read = read_grey_levels(path)
            assert read.dtype == kind
            assert np.array_equal(read, grey)
            if bits == 8:
                assert np.array_equal(read_picture(path), colours if photometric == "rgb" else grey)


def test_layouts_that_are_not_read_say_what_to_do(tmp_path: Path) -> None:
    colours = np.random.default_rng(1).random((40, 56, 3)).astype(np.float32)
    for planes, stored in (("contig", colours), ("separate", np.moveaxis(colours, -1, 0))):
        tifffile.imwrite(tmp_path / "image.tif", stored, photometric="rgb", planarconfig=planes)
        with pytest.raises(ImageError, match="packed in a way that is not read; save it as grey levels, uncompressed"):
            read_grey_levels(tmp_path / "image.tif")


@pytest.mark.parametrize("ending", [".png", ".jpg", ".tif", ".bmp"])
def test_sizes_are_looked_at_before_pixels(ending: str, tmp_path: Path) -> None:
    """Each file is small and says it has 60,000 x 60,000 px."""
    path = tmp_path / f"bomb{ending}"
    if ending == ".tif":
        tifffile.imwrite(path, np.zeros((60, 60_000), np.uint8), compression="zlib")
        data = bytearray(path.read_bytes())
        with tifffile.TiffFile(path) as tiff:
            at = tiff.pages[0].tags["ImageLength"].valueoffset
        data[at : at + 2] = (60_000).to_bytes(2, "little")
    else:
        Image.fromarray(GREY).save(path)
        data = bytearray(path.read_bytes())
        if ending == ".bmp":
            data[18:26] = (60_000).to_bytes(4, "little") * 2
        elif ending == ".jpg":
            at = data.index(b"\xff\xc0")
            data[at + 5 : at + 9] = (60_000).to_bytes(2, "big") * 2
        else:
            data[16:24] = (60_000).to_bytes(4, "big") * 2
            data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    path.write_bytes(data)
    with pytest.raises(ImageError, match="it claims 60000 x 60000 px"):
        read_grey_levels(path)


def test_pipes_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.tif").symlink_to("/dev/zero")
    for name in ("pipe.png", "zero.tif"):
        with pytest.raises(ImageError, match=f"{name} is no regular file"):
            read_grey_levels(tmp_path / name)


def test_written_pictures_are_red_green_blue(tmp_path: Path) -> None:
    colours = np.random.default_rng(2).integers(0, 256, (20, 30, 3), np.uint8)
    write_png(colours, tmp_path / "new" / "colours.png")
    with Image.open(tmp_path / "new" / "colours.png") as picture:
        assert np.array_equal(np.asarray(picture), colours)
    assert np.array_equal(cv2.imdecode(np.frombuffer(encode_png(GREY), np.uint8), cv2.IMREAD_UNCHANGED), GREY)


@pytest.mark.parametrize("ending", [".png", ".jpg", ".tif", ".bmp"])
def test_cut_off_images_are_refused_in_one_sentence(
    ending: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"image{ending}"
    Image.fromarray(GREY).save(path)
    whole = path.read_bytes()
    for length in np.linspace(0, len(whole) - 2, 15, dtype=int).tolist():
        path.write_bytes(whole[:length])
        with pytest.raises(ImageError, match=rf"^image {path} cannot be read: it is [A-Za-z ,]+$"):
            read_grey_levels(path)
    if ending != ".tif":
        assert capfd.readouterr().err == ""  # no decoder said a word of its own


def test_damaged_pngs_are_refused_without_another_word(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = encode_png(GREY)
    for bit in np.random.default_rng(3).integers(0, 8 * len(whole), 60).tolist():
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        (tmp_path / "image.png").write_bytes(damaged)
        with pytest.raises(ImageError, match="cannot be read"):
            read_grey_levels(tmp_path / "image.png")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("progressive", [False, True])
def test_damage_in_the_middle_of_a_jpeg_is_refused(
    progressive: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "image.jpg"
    noise = np.random.default_rng(4).integers(0, 256, (96, 128), np.uint8)
    Image.fromarray(noise).save(path, quality=90, progressive=progressive)
    whole = path.read_bytes()
    assert np.abs(read_grey_levels(path).astype(float) - noise).mean() < 20
    path.write_bytes(whole[:2000] + bytes(400) + whole[2400:])
    with pytest.raises(ImageError, match=r"image.jpg cannot be read: it is damaged$"):
        read_grey_levels(path)
    assert capfd.readouterr().err == ""


def test_the_checksums_of_a_packed_tiff_are_reached(tmp_path: Path) -> None:
    noise = np.random.default_rng(4).integers(0, 256, (96, 128), np.uint8)
    tifffile.imwrite(tmp_path / "image.tif", noise, compression="zlib", rowsperstrip=40)
    assert np.array_equal(read_grey_levels(tmp_path / "image.tif"), noise)
    whole = (tmp_path / "image.tif").read_bytes()
    for bit in range(0, 800, 97):
        damaged = bytearray(whole)
        damaged[len(whole) // 2 + bit // 8] ^= 1 << bit % 8
        (tmp_path / "image.tif").write_bytes(damaged)
        with pytest.raises(ImageError, match=r"image.tif cannot be read: it is damaged"):
            read_grey_levels(tmp_path / "image.tif")


def test_a_damaged_run_length_bmp_is_one_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "image.bmp"
    Image.fromarray(GREY).save(path)
    data = bytearray(path.read_bytes())
    data[28], data[30] = 4, 1  # run lengths of 8 bits in an image of 4
    path.write_bytes(data)
    with pytest.raises(ImageError, match=r"image.bmp cannot be read"):
        read_grey_levels(path)
    assert capfd.readouterr().err == ""


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("no image")
    for name, said in (
        ("empty.png", "it is empty"),
        ("text.png", "it is damaged, or no image"),
        ("none.png", "is missing"),
        ("", "is no regular file"),
    ):
        with pytest.raises(ImageError, match=said):
            read_grey_levels(tmp_path / name)


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("1.5,-2,3e2", [1.5, -2, 300]),
        ("1,5;-2;3,25e1", [1.5, -2, 32.5]),
        ("1,5\t-2,5\t3", [1.5, -2.5, 3]),
        ("1,5  -2,5 3", [1.5, -2.5, 3]),
        ('"1,5","-2,5","3"', [1.5, -2.5, 3]),
        ("1,2,,,", [1, 2]),
        ("1;2;\r", [1, 2]),
        ("1,5", [1, 5]),
        ("1.234,5;2;3", None),  # neither a thousand nor a decimal is sure
        ("1_000,2", None),
        ("1,,2", None),
        ("", []),
    ],
)
def test_numbers_of_a_line(line: str, numbers: list[float] | None) -> None:
    assert numbers_in(line) == numbers


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_with_and_without_a_mark(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "marks.json"
    path.write_bytes('["ä"]'.encode(encoding))
    assert read_text(path, "file") == '["ä"]'
    assert read_json(path, "file") == ["ä"]


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "binary").write_bytes(b"\x89PNG\r\n")
    (tmp_path / "half").write_bytes(codecs.BOM_UTF16_LE + b"a")
    os.mkfifo(tmp_path / "pipe")
    for name in ("binary", "half"):
        with pytest.raises(ValueError, match=f"{name}: expected a text file, a camera file, found binary data"):
            read_text(tmp_path / name, "camera file")
    for name in ("pipe", ""):
        with pytest.raises(ValueError, match="is no regular file"):
            read_text(tmp_path / name, "camera file")
    with pytest.raises(FileNotFoundError, match=r"^camera file .*none is missing$"):
        read_text(tmp_path / "none", "camera file")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match=r"large has 1.1e.03 GB, at most .* are read"):
        read_text(tmp_path / "large", "camera file")


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 255, (61, 83))


@pytest.mark.parametrize("shape", [(), (0,), (7,), (1024,), (3000,), (40, 50, 3)])
@pytest.mark.parametrize("outside", [None, 0.0])
def test_values_between_pixels(shape: tuple[int, ...], outside: float | None, image: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 82, shape), rng.uniform(0, 60, shape)
    expected = ndimage.map_coordinates(image, [y.ravel(), x.ravel()], order=1).reshape(shape)
    values = sampled(image, x, y, outside)
    assert values.shape == shape
    assert np.abs(values - expected).max(initial=0.0) < 0.01  # places are float32
    far = sampled(image, np.array([-9.0, 200.0]), np.array([30.0, 30.0]), outside)
    assert far == pytest.approx([image[30, 0], image[30, -1]] if outside is None else [0.0, 0.0], rel=1e-6)


def test_more_places_than_opencv_takes_at_once(image: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = np.linspace(0, 82, 5000, dtype=np.float32), np.full(5000, 7.0, np.float32)
    at_once = sampled(image, x, y)
    monkeypatch.setattr("guide3d.image_filters._MAP_WIDTH", 16)  # more than 16 * 16 rows of as many are split
    assert np.array_equal(sampled(image, x, y), at_once)
