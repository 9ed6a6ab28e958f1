"""Reader: the shipped weights find a wire and no other thing; files of another kind or version are refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.model_file import read_content, write_content
from guide3d.modeling.reader_network import ReaderNetwork
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.maps import Reader

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


def test_a_file_of_another_version_is_refused_by_name(tmp_path: Path) -> None:
    small_reader().save(tmp_path / "reader.pt")
    content = read_content(tmp_path / "reader.pt")
    content["network"]["version"] = 99
    write_content(tmp_path / "reader.pt", content)
    with pytest.raises(ValueError, match=r"reader\.pt is a reader of version 99, expected 1"):
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


def test_weights_of_another_size_are_refused(tmp_path: Path) -> None:
    small_reader().save(tmp_path / "reader.pt")
    content = read_content(tmp_path / "reader.pt")
    content["network"]["widths"] = [8, 16]
    write_content(tmp_path / "reader.pt", content)
    with pytest.raises(ValueError, match="another architecture"):
        Reader.load(tmp_path / "reader.pt")


@pytest.mark.parametrize("image", [np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8)), np.zeros((0, 8), np.uint8)])
def test_other_images_are_refused(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected a grey image"):
        small_reader().maps(image)
