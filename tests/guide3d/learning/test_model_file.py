"""Damaged models: one wrong bit, a cut, a weight that is no number: refused with one sentence."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from guide3d.geometry.distortion import Distortion
from guide3d.learning.build import FGRN_SIZES, SEGMENTER_SIZES, SHAPE_SIZES, build_shape_network
from guide3d.learning.model_file import read_content, write_content
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor, built
from guide3d.learning.preprocessing import Preprocessing
from guide3d.modeling.fgrn import FGRN
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
    assert require_refusals(path, lambda: type(model).load(path)) > 24


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
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


def _expanded() -> torch.Tensor:
    return torch.zeros(1).expand(10**6, 10**6)


def _sparse() -> torch.Tensor:
    return torch.sparse_coo_tensor(torch.zeros((2, 1), dtype=torch.long), torch.ones(1), (10**9, 10**9))


def _quantised() -> torch.Tensor:
    return torch.quantize_per_tensor(torch.zeros(4), 0.1, 0, torch.qint8)


def _recursive() -> list:
    content: list = []
    content.append(content)
    return content


def _branching() -> list:
    content: list = []
    for _ in range(40):
        content = [content] * 10
    return content


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_expanded, "sparse, quantised or expanded"),
        (_sparse, "sparse, quantised or expanded"),
        (_quantised, "sparse, quantised or expanded"),
        (lambda: torch.empty((10**6, 10**6), device="meta"), "sparse, quantised or expanded"),
        (_recursive, "nested without end"),
        (_branching, "nested without end"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_content_that_would_grow_is_refused(content: Callable[[], Any], said: str, tmp_path: Path) -> None:
    stream = io.BytesIO()
    torch.save({"weights": {"a": content()}}, stream)
    data = stream.getvalue()
    (tmp_path / "model.pt").write_bytes(b"sha256 " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
    with pytest.raises(ValueError, match=said):
        read_content(tmp_path / "model.pt")
    with pytest.raises(ValueError, match=rf"model\.pt is damaged or no network \(.*{said}\)"):
        ShapePredictor.load(tmp_path / "model.pt")


def test_compressed_archives_are_refused(tmp_path: Path) -> None:
    stream, packed = io.BytesIO(), io.BytesIO()
    torch.save({"a": torch.zeros(10**6)}, stream)
    with zipfile.ZipFile(stream) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            target.writestr(name, source.read(name))
    data = packed.getvalue()
    assert len(data) < 10_000
    (tmp_path / "model.pt").write_bytes(b"sha256 " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
    with pytest.raises(ValueError, match="its archive is compressed"):
        read_content(tmp_path / "model.pt")


@pytest.mark.parametrize("kind", MODELS)
def test_settings_of_other_sizes_than_the_weights_are_refused_before_they_are_built(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    content = read_content(path)
    for network in _enlarged(content["network"]):
        write_content(path, content | {"network": network})
        with pytest.raises(ValueError, match="of another architecture"):
            type(model).load(path)


def _enlarged(description: dict[str, Any]) -> list[dict[str, Any]]:
    """The description with each of its sizes ten thousand times as large."""
    found = []
    for key, value in description.items():
        if isinstance(value, dict):
            found += [description | {key: inner} for inner in _enlarged(value)]
        elif type(value) is int and value > 3:
            found += [description | {key: value * 10**4}, description | {key: 10**12}]
    return found


def test_a_pipe_is_no_model(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "model.pt")
    with pytest.raises(ValueError, match="is no regular file"):
        read_content(tmp_path / "model.pt")
