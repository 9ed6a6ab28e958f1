"""Images of any kind and size give a curve with its confidence; the reader behind that, and its files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d import read
from guide3d.learning.model_file import read_content, write_content
from guide3d.modeling.reader_network import ReaderNetwork
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.curve_reading import Prior
from guide3d.reading.grey_image import grey_image
from guide3d.reading.maps import Reader
from tests.guide3d.reading.drawn_maps import DarkLineReader, DrawnMaps, bent, maps_of, picture, within
from tests.guide3d.reading.test_curve_reading import ARCH, TWO

READER = DarkLineReader()
MAPS = maps_of(ARCH)


def test_a_curve_is_read_with_its_confidence() -> None:
    reading = read(picture(MAPS), DarkLineReader(MAPS.tip))
    assert reading.found
    assert np.hypot(*(reading.tip_px - MAPS.points_px[0])) < 4.0
    assert within(reading.points_px, MAPS.points_px) > 0.99
    assert reading.confidence.shape == reading.sd_px.shape == (len(reading.points_px),)
    assert reading.overall_confidence > 0.8
    assert not reading.messages


@pytest.mark.parametrize("kind", ["inverted", "16 bits", "twice as large"])
def test_other_kinds_of_image_give_the_same_curve(kind: str) -> None:
    image = picture(MAPS)
    scale, said = 1.0, ""
    if kind == "inverted":
        image, said = 255 - image, "was inverted"
    elif kind == "16 bits":
        image, said = image.astype(np.uint16) * 16, "8 bits"
        image[::7, ::7] = 235 * 16  # the brightest level
    else:
        image, scale, said = np.kron(image, np.ones((2, 2), np.uint8)), 2.0, "was read at 1024 x 1024 px"
    reading = read(image, READER)
    assert within(reading.points_px, (MAPS.points_px + 0.5) * scale - 0.5, 4.0 * scale) > 0.99
    assert any(said in message for message in reading.messages)


def test_no_wire_is_said() -> None:
    rng = np.random.default_rng(0)
    reading = read(rng.integers(160, 200, (300, 300), dtype=np.uint8), READER)
    assert not reading.found
    assert (reading.tip_px, reading.overall_confidence, len(reading.points_px)) == (None, 0.0, 0)
    assert reading.messages == ["no wire was found"]


def test_candidates_can_be_chosen_and_a_prior_chooses() -> None:
    line = bent([(400, 0.0)], (300, 500), 0.0)
    image = picture(maps_of(line, tip=0.0))
    reading = read(image, READER)
    tips = [reading.with_candidate(number).points_px[0] for number in range(len(reading.candidates))]
    assert np.ptp([tip[0] for tip in tips]) > 350
    for ordered in (line, line[::-1]):
        assert np.hypot(*(read(image, READER, Prior(ordered)).points_px[0] - ordered[0])) < 6.0


CURL = bent([(160, -0.033), (300, 0.0), (600, 0.001)], (500, 500), 1.0)


def _drawn(course: np.ndarray, width_px: float = 3.0) -> RandomImage:
    plain = FluoroscopySettings(
        narrowest_px=width_px, widest_px=width_px, weakest=0.7, no_wire=0, two_devices=0, catheter=0, along_edge=0,
        in_vessel=0, tip_change=0, beads=0, markers=0, clutter=1e-6, contrast=0, noise=2, field=0, jpeg=0,
    )  # fmt: skip
    return RandomFluoroscopy(plain, 3).along(0, [course])


@pytest.mark.parametrize("side_px", [256, 1024, 3072])
def test_one_image_of_any_size_is_read_alike(side_px: int) -> None:
    drawn = _drawn(ARCH)
    way = cv2.INTER_AREA if side_px < 1024 else cv2.INTER_CUBIC
    reading = read(cv2.resize(drawn.image, (side_px, side_px), interpolation=way))
    points = (reading.points_px + 0.5) * 1024 / side_px - 0.5
    assert within(points, np.concatenate(drawn.wires[0])) > 0.95
    said = f"the image of {side_px} x {side_px} px was read at 1024 x 1024 px"
    assert (said in reading.notes) == (side_px != 1024)


@pytest.mark.parametrize("width_px", [1.5, 6.0, 10.0])
def test_wires_of_any_width_are_read_and_nothing_else(width_px: float) -> None:
    drawn = _drawn(ARCH, width_px)
    reading = read(drawn.image)
    assert within(reading.points_px, np.concatenate(drawn.wires[0])) > 0.95
    assert within(np.concatenate(drawn.wires[0]), reading.points_px) > 0.95
    assert not reading.others
    smaller = {f"the image of 1024 x 1024 px was read at {side} x {side} px" for side in (512, 384)}
    assert bool(smaller & set(reading.notes)) == (width_px > 5)


@pytest.mark.parametrize("width_px", [2.5, 6.0])
def test_a_curled_tip_is_followed_to_its_end(width_px: float) -> None:
    drawn = _drawn(CURL, width_px)
    reading = read(drawn.image)
    assert within(reading.points_px, np.concatenate(drawn.wires[0])) > 0.97
    assert np.hypot(*(reading.points_px[0] - CURL[0])) < 6.0


RNG = np.random.default_rng(0)
GREY = RNG.integers(20, 220, (256, 300), dtype=np.uint8)


@pytest.mark.parametrize("factor", [16, 1e-3])
def test_other_depths_are_brought_to_bytes(factor: float) -> None:
    deep = (GREY.astype(float) * factor).astype(np.uint16 if factor > 1 else np.float64)
    grey = grey_image(deep)
    assert grey.pixels.dtype == np.uint8
    assert np.corrcoef(grey.pixels.ravel(), GREY.ravel())[0, 1] > 0.999
    assert "taken to 8 bits" in grey.messages[0]


def test_saturated_pixels_and_a_pedestal_leave_the_contrast() -> None:
    deep = 16 * GREY.astype(np.uint16) + 20_000
    deep[:, :8] = 65_535  # 2.7 %
    pixels = grey_image(deep).pixels
    assert np.ptp(pixels[:, 8:].astype(float)) > 140
    assert pixels[:, :8].min() == 255
    plain = grey_image(deep[:, 8:] - 20_000).pixels.astype(float)
    assert np.abs(grey_image(deep - 20_000).pixels[:, 8:] - plain).max() <= 2


def test_channels_that_agree_are_grey_and_a_photograph_is_refused() -> None:
    assert np.array_equal(grey_image(np.repeat(GREY[..., None], 3, axis=2)).pixels, GREY)
    photograph = RNG.integers(0, 255, (256, 256, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match=r"expected a grey X-ray image, got a picture of which \d+% is coloured"):
        grey_image(photograph)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((256, 256), np.uint8), "no contrast"),
        (RNG.integers(0, 255, (64, 64), dtype=np.uint8), "at least 128 x 128 px, got 64 x 64"),
        (np.zeros(10), "expected a grey image"),
        ("a.png", "got the path 'a.png': read the file first, by guide3d.image_file.read_grey_levels"),
        (Path("a.png"), "got the path 'a.png': read the file first"),
        (np.where(RNG.random((200, 200)) < 0.01, np.nan, 1.0), "finite"),
        (np.repeat(GREY[..., None], 3, axis=2) * 1e305, "finite grey values of at most 1e[+]30"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        grey_image(image)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("side", "shape"), [(1024, (1024, 901)), (512, (512, 451)), (2049, (2049, 1803))])
def test_images_are_resampled_and_points_go_both_ways(side: int, shape: tuple[int, int]) -> None:
    grey = grey_image(RNG.integers(0, 255, (2049, 1803), dtype=np.uint8)).resampled(side)
    assert grey.pixels.shape == grey.outside.shape == shape
    points = RNG.uniform(0, 900, (5, 2))
    assert np.allclose(grey.from_given(grey.to_given(points)), points)
    corners = np.array([[-0.5, -0.5], [shape[1] - 0.5, shape[0] - 0.5]])  # the border of the image stays its border
    assert np.allclose(grey.to_given(corners), [[-0.5, -0.5], [1802.5, 2048.5]])


def test_several_wires_are_said_and_given() -> None:
    both = DrawnMaps(ARCH, np.maximum(MAPS.wire, maps_of(TWO).wire), MAPS.tip)
    reading = read(picture(both), READER)
    assert any("there are 2 wires" in message for message in reading.messages)
    assert len(reading.others) == 1


def test_a_straight_line_across_a_small_image_is_no_wire_without_a_word() -> None:
    drawn = _drawn(np.array([(1023, 420), (0, 300)], float), 8.0)
    reading = read(cv2.resize(drawn.image, (256, 256), interpolation=cv2.INTER_AREA))
    assert not reading.found or any("straight as a rod" in note for note in reading.notes)


CLEAR = FluoroscopySettings(
    image_px=512, no_wire=0.0, two_devices=0.0, catheter=0.0, clutter=0.3, noise=1.5, weakest=0.72, narrowest_px=2.5,
    anatomy=0.0, contrast=0.0,
)  # fmt: skip


def small_reader() -> Reader:
    torch.manual_seed(0)
    return Reader(ReaderNetwork(widths=(8, 12)), {"seed": 0}, fast=False)


def test_a_saved_reader_reads_the_same(tmp_path: Path) -> None:
    reader = small_reader()
    reader.save(tmp_path / "reader.pt")
    again = Reader.load(tmp_path / "reader.pt", fast=False)
    image = np.random.default_rng(1).integers(0, 255, (48, 48), np.uint8)
    np.testing.assert_allclose(again.maps(image).wire, reader.maps(image).wire, atol=2e-3)  # half precision
    assert again.metadata == {"seed": 0}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("version", 99, r"reader\.pt is a reader of version 99"), ("widths", [8, 16], "another architecture")],
)
def test_files_of_other_readers_are_refused(name: str, value: object, said: str, tmp_path: Path) -> None:
    small_reader().save(tmp_path / "reader.pt")
    content = read_content(tmp_path / "reader.pt")
    content["network"][name] = value
    write_content(tmp_path / "reader.pt", content)
    with pytest.raises(ValueError, match=said):
        Reader.load(tmp_path / "reader.pt")


def test_the_shipped_reader_finds_wires() -> None:
    reader, fluoroscopy = Reader.pretrained(), RandomFluoroscopy(CLEAR, seed=12)
    both = marked = true = 0
    for index in range(6):
        drawn = fluoroscopy.image(index)
        found, mask = reader.maps(drawn.image).wire > 0.5, drawn.wire > 127
        both, marked, true = both + (found & mask).sum(), marked + found.sum(), true + mask.sum()
    assert both > 0.75 * true
    assert both > 0.6 * marked


def test_the_shipped_reader_sees_no_wire_where_there_is_none() -> None:
    reader = Reader.pretrained()
    noise = np.random.default_rng(0).normal(110, 3, (256, 256)).astype(np.uint8)
    for image in (noise, np.zeros((256, 256), np.uint8), np.full((64, 64), 255, np.uint8)):
        assert (reader.maps(image).wire > 0.5).sum() < 20


@pytest.mark.parametrize("image", [np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8)), np.zeros((0, 8), np.uint8)])
def test_other_images_are_refused(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected a grey image"):
        small_reader().maps(image)
