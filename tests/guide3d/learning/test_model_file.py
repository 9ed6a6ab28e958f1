"""Damaged models: one wrong bit, a cut, a weight that is no number: refused with one sentence."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from guide3d.geometry.distortion import Distortion
from guide3d.learning.build import FGRN_SIZES, SEGMENTER_SIZES, SHAPE_SIZES, build_shape_network
from guide3d.learning.model_file import read_content, write_content
from guide3d.learning.picture_store import Preprocessing
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor, built
from guide3d.modeling.shape_network import FGRN
from tests.damaged_files import damaged, refusals
from tests.forged_models import require_refusals


def shape() -> ShapePredictor:
    size = SHAPE_SIZES["smoke"]
    return ShapePredictor.of(build_shape_network(size, None, 6), size, Preprocessing(size.image_px))


def fgrn() -> FGRNPredictor:
    size = {"points": 6, **FGRN_SIZES["smoke"]}
    return FGRNPredictor(FGRN(**size), size, Preprocessing(80), {})


def segmentation() -> SegmentationPredictor:
    size = {"name": "unet", "crop_px": 32, "sizes": SEGMENTER_SIZES["unet"]["smoke"]}
    return SegmentationPredictor(built(size), size, Preprocessing(64), {})


MODELS: dict[str, Callable[[], Any]] = {make.__name__: make for make in (shape, fgrn, segmentation)}


@pytest.mark.parametrize("kind", MODELS)
def test_a_wrong_bit_is_refused(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    messages = refusals(path, lambda: type(model).load(path))
    assert all("model.pt is damaged or no network" in message for message in messages)


@pytest.mark.parametrize("kind", MODELS)
def test_a_model_that_asks_for_more_than_it_holds_is_refused_before_it_is_built(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    first = kind == "shape"
    count = require_refusals(path, lambda: type(model).load(path), forged=first)
    assert count > (50 if first else 12)


@pytest.mark.parametrize("value", [float("inf")])
@pytest.mark.parametrize("kind", MODELS)
def test_weights_that_are_no_numbers_are_neither_written_nor_read(kind: str, value: float, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    before = path.read_bytes()
    next(model.network.parameters()).data.view(-1)[0] = value
    with pytest.raises(ValueError, match=r"model\.pt was not written: .* is not finite; train it again"):
        model.save(path)
    assert path.read_bytes() == before
    content = read_content(path)
    write_content(path, content | {"weights": model.network.state_dict()})
    with pytest.raises(ValueError, match=r"model\.pt: .* is not finite: train it again"):
        type(model).load(path)


def test_a_wrong_bit_of_a_distortion_is_refused_or_changes_nothing(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 63, 6), np.linspace(0, 63, 6)), axis=-1).reshape(-1, 2)
    path = tmp_path / "A.npz"
    Distortion(grid + 0.5, grid, 64, 64).save(path)
    whole, refused = path.read_bytes(), 0
    for data in damaged(b"\n" + whole):
        path.write_bytes(data[1:])
        try:
            there = Distortion.load(path)
        except ValueError as error:
            refused += 1
            if "expected a map as Distortion.save writes it" not in str(error):
                raise
        else:
            assert np.array_equal(there.raw_px, grid + 0.5)
            assert np.array_equal(there.ideal_px, grid)
            assert (there.width, there.height, there.method, there.neighbours, there.spans) == (
                64,
                64,
                "local weighted mean",
                25,
                24,
            )
    assert refused > 100


@pytest.mark.parametrize("kind", MODELS)
def test_files_of_other_versions_are_one_sentence(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    torch.save({"format": "guide3d-network-1"}, path)
    with pytest.raises(ValueError, match="is a file of an older format, without a digest: train it again"):
        type(model).load(path)
    model.save(path)
    content = read_content(path)
    for name in content:
        for change in ({}, {name: None}, {name: [1]}, {name: {"a": 1}}):
            write_content(path, {key: value for key, value in content.items() if key != name} | change)
            if name == "metadata" and isinstance(change.get(name), dict):
                continue
            with pytest.raises(ValueError, match=r"model\.pt is .*(train it again|give the other file)"):
                type(model).load(path)
