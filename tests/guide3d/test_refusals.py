"""What cannot be is refused in a sentence that says what there is."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.calibration import __main__ as calibration_command
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.learning.build import SEGMENTER_SIZES, SHAPE_SIZES, build_segmenter, build_shape_network
from guide3d.learning.reader.training import ReaderRecipe
from guide3d.modeling.spherical import SphericalForm
from guide3d.modeling.vision_transformer import VisionTransformer
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.reading.curve_reading import read_curves
from guide3d.reconstruction.synthetic_scene import rig

FORM = SphericalForm(1.7, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), 0.0, 1.5)
SMOKE = SHAPE_SIZES["smoke"]
REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: EpipolarGeometry(rig()[0], rig()[0]), "one and the same source"),
    (
        lambda: VisionTransformer(image_px=100, patch_px=16, channels=1, width=8, depth=1, heads=1, hidden=8),
        "does not divide into patches of 16 px",
    ),
    (lambda: build_segmenter("vnet", 64), "unknown segmentation network 'vnet'; there are unet, transunet, swinunet"),
    (lambda: build_shape_network(dataclasses.replace(SMOKE, pooling="mean"), FORM, 5), "unknown pooling 'mean'"),
    (lambda: build_shape_network(dataclasses.replace(SMOKE, anchor="middle"), FORM, 5), "there are tip, entry"),
    (
        lambda: build_shape_network(SMOKE, dataclasses.replace(FORM, cumulative=True), 5),
        "offsets from step to step begin at the tip",
    ),
    (
        lambda: build_segmenter("swinunet", 64, **SEGMENTER_SIZES["swinunet"]["smoke"])(torch.zeros(1, 1, 32, 32)),
        "expected images of 64 x 64 px",
    ),
    (lambda: ReaderRecipe(tile_px=100), "tile_px must be a multiple of 32"),
    (lambda: RandomFluoroscopy().clutter(0, 2000), "size_px: expected 32 to 1024 px"),
    (
        lambda: read_curves(np.zeros((64, 64), np.float32), np.zeros((32, 32), np.float32)),
        r"expected maps of one shape, got \(64, 64\) of the wire and \(32, 32\)",
    ),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("folder", ["none", "."])
def test_a_calibration_of_nothing(folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibration_command.main([str(tmp_path / folder), "--output", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
