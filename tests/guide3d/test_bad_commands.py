"""Commands and calls: whatever is wrong with files, folders and numbers is one sentence."""

import dataclasses
import logging
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d import train
from guide3d.calibration import __main__ as calibration_command
from guide3d.commands import in_words
from guide3d.dataset.dataset import Dataset
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.metrics import mers, mete
from guide3d.geometry.polyline import checked, resample
from guide3d.image_file import write_png
from guide3d.learning.build import SEGMENTER_SIZES, SHAPE_SIZES, build_segmenter, build_shape_network
from guide3d.learning.reader.training import ReaderRecipe
from guide3d.modeling.spherical import SphericalForm
from guide3d.modeling.vision_transformer import VisionTransformer
from guide3d.random_fluoroscopy.anatomy import projected_ct
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.curve_reading import read_curves
from guide3d.reconstruction.synthetic_scene import rig
from tests.guide3d.learning.drawn_data import draw

SMOKE = ("--network", "unet", "--size", "smoke", "--device", "cpu")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    draw(folder)
    (folder / "file").write_text("no folder")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ("{data}/file", "--output", "{out}"),
        ("{data}", "--output", "{data}/file"),
        ("{data}", "--output", "{out}/" + 300 * "n"),
        ("{data}", "--output", "{out}", "--epochs", "0"),
        ("{data}", "--output", "{out}", "--pictures", "{data}/file"),
        ("{data}", "--output", "{out}", "--images", "{data}/none"),
        ("{data}", "--output", "{out}", "--calibration", "{data}/file"),
        ("{data}", "--output", "{out}", "--curves", "{data}/file", "--network", "fgrn"),
        ("{data}", "--output", "{out}", "--pretrained", "{data}", "--network", "spherical"),
    ],
)
def test_training_refuses_with_one_sentence(
    words: tuple[str, ...], data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given = [word.format(data=data, out=tmp_path) for word in words]
    with caplog.at_level(logging.ERROR):
        assert train.main([given[0], *SMOKE, *given[1:]]) == 2
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert len(said) == 1
    assert "\n" not in said[0]


@pytest.mark.parametrize("name", ["raw.json", "dataset.json", "truth.json"])
@pytest.mark.parametrize("text", ["", "[" * 100_000, "[]", "\x00"])
def test_files_of_a_data_set_that_are_none_are_refused(name: str, text: str, data: Path) -> None:
    whole = (data / name).read_text()
    (data / name).write_text(text)
    try:
        with pytest.raises(ValueError, match=f"{name}|holds no frame that can be used"):
            Dataset.open(data)
    finally:
        (data / name).write_text(whole)


@pytest.mark.skipif(sys.platform == "win32", reason="it has no limit of a file's size")
def test_a_full_disk_is_one_sentence_with_the_file_and_leaves_no_part(tmp_path: Path) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8, before[1]))
    try:
        with pytest.raises(OSError, match="File too large") as raised:
            write_png(np.zeros((64, 64), np.uint8), tmp_path / "new.png")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert in_words(raised.value) == f"{tmp_path / 'new.png'}: File too large"
    assert not list(tmp_path.iterdir())


FORM = SphericalForm(1.7, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), 0.0, 1.5)
SMALLEST = SHAPE_SIZES["smoke"]
LINE = np.outer(np.linspace(0.0, 30.0, 31), [1.0, 0.0, 0.0])  # mm
REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: EpipolarGeometry(rig()[0], rig()[0]), "one and the same source"),
    (
        lambda: VisionTransformer(image_px=100, patch_px=16, channels=1, width=8, depth=1, heads=1, hidden=8),
        "does not divide into patches of 16 px",
    ),
    (lambda: build_segmenter("vnet", 64), "unknown segmentation network 'vnet'; there are unet, transunet, swinunet"),
    (lambda: build_shape_network(dataclasses.replace(SMALLEST, pooling="mean"), FORM, 5), "unknown pooling 'mean'"),
    (lambda: build_shape_network(dataclasses.replace(SMALLEST, anchor="middle"), FORM, 5), "there are tip, entry"),
    (
        lambda: build_shape_network(SMALLEST, dataclasses.replace(FORM, cumulative=True), 5),
        "offsets from step to step begin at the tip",
    ),
    (
        lambda: build_segmenter("swinunet", 64, **SEGMENTER_SIZES["swinunet"]["smoke"])(torch.zeros(1, 1, 32, 32)),
        "expected images of 64 x 64 px",
    ),
    (lambda: ReaderRecipe(tile_px=100), "tile_px must be a multiple of 32"),
    (
        lambda: read_curves(np.zeros((64, 64), np.float32), np.zeros((32, 32), np.float32)),
        r"expected maps of one shape, got \(64, 64\) of the wire and \(32, 32\)",
    ),
    (lambda: RandomFluoroscopy().tile(0, 2048), "size_px: expected 32 to 1024 px"),
    (lambda: RandomFluoroscopy(courses=[np.zeros((3, 4))]), "a course must be"),
    (lambda: RandomFluoroscopy(backgrounds=[np.full((3, 4), np.nan)]), "a background must be"),
    (lambda: FluoroscopySettings(narrowest_px=5.0), "narrowest_px must not exceed"),
    (lambda: FluoroscopySettings(strongest=0.95), "strongest <= weakest"),
    (lambda: FluoroscopySettings(near_tip=0.8), "near_tip"),
    (lambda: projected_ct(np.zeros((3, 3)), (1, 1, 1), 0), "expected a volume"),
    (lambda: projected_ct(np.zeros((3, 3, 3)), (1, 0, 1), 0), "spacing_mm"),
    (
        lambda: checked([[1.0, 2.0], [1.0, 2.0]], 2, "annotation of camera A"),
        "camera A: expected at least 2 different points, got 1",
    ),
    (lambda: checked([1.0, 2.0], 2, "annotation of camera A"), r"expected points of shape \(n, 2\), got \(2,\)"),
    (lambda: checked([[0.0, 0.0], [np.nan, 1.0]], 2, "annotation of camera A"), "point 1 is not finite"),
    (lambda: mete(LINE, LINE[:1]), "curve b: expected at least 2 different points"),
    (lambda: mers(LINE, LINE, spacing_mm=0.0), "spacing_mm"),
    (lambda: resample(LINE, spacing=0.0), "spacing above 0"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("folder", ["none", "."])
def test_a_calibration_of_nothing(folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibration_command.main([str(tmp_path / folder), "--output", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
