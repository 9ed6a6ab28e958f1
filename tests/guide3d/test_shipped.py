"""What is shipped and public: networks by name, threads of OpenCV, names; damaged files of models are refused."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guide3d
from guide3d import shipped
from guide3d.geometry.distortion import Distortion
from guide3d.learning.build import FGRN_SIZES, SEGMENTER_SIZES, SHAPE_SIZES, build_shape_network
from guide3d.learning.model_file import read_content, write_content
from guide3d.learning.picture_store import Preprocessing
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor, built
from guide3d.modeling.shape_network import FGRN
from tests.damaged_files import damaged, refusals
from tests.forged_models import require_refusals

SHIPPED = Path(shipped.__file__).parent / "weights"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the installed weights, with a copy of the reader."""
    monkeypatch.setattr(shipped, "files", lambda package: tmp_path / package)
    weights = tmp_path / "guide3d.weights"
    weights.mkdir()
    (weights / "reader.pt").write_bytes((SHIPPED / "reader.pt").read_bytes())
    (weights / "reader.md").write_text("# reader\n\nReads\nwires.\n\nmore\n")
    return weights


def test_networks_of_the_data_set_predict() -> None:
    image = np.full((1024, 1024), 150, np.uint8)
    image[:600, 510:515] = 40
    mask = guide3d.load("unet").predict(image)
    assert mask.shape == (1024, 1024)
    assert (mask[100:500, 508:517] > 0).mean() > 0.5
    assert (mask[:, :400] > 0).mean() < 0.01
    curve = guide3d.load("shape").predict([image] * 3)
    assert curve.shape[1] == 3
    assert np.linalg.norm(np.diff(curve, axis=0), axis=1) == pytest.approx(1.7, abs=0.1)


@pytest.mark.parametrize("use", [guide3d.load, shipped.card])
def test_an_unknown_name_is_refused_with_the_known_ones(folder: Path, use: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match="there is no model 'unet9': choose from reader"):
        use("unet9")


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"OMP_NUM_THREADS": "3"}, 3),
        ({"OMP_NUM_THREADS": "3", "OPENCV_FOR_THREADS_NUM": "2"}, 2),
        ({"OMP_NUM_THREADS": "4,2"}, None),  # OpenMP's own form for nested loops: left to OpenCV
        ({}, None),
    ],
)
def test_threads_follow_the_environment(environment: dict[str, str], expected: int | None) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.endswith(("NUM_THREADS", "THREADS_NUM"))}
    snippet = "import cv2; own = cv2.getNumThreads(); import guide3d.opencv; print(own, cv2.getNumThreads())"
    run = subprocess.run([sys.executable, "-c", snippet], env={**kept, **environment}, capture_output=True, check=True)
    own, followed = (int(word) for word in run.stdout.split())
    assert followed == (own if expected is None else expected)


def test_the_function_read_stays_one_when_its_command_is_imported() -> None:
    code = "import guide3d, guide3d.read as first; import guide3d.read; assert first is guide3d.read; print(first)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("<function read")


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


def test_a_wrong_bit_is_refused(tmp_path: Path) -> None:
    model, path = shape(), tmp_path / "model.pt"
    model.save(path)
    messages = refusals(path, lambda: ShapePredictor.load(path))
    assert all("model.pt is damaged or no network" in message for message in messages)
    path.write_text("something else")
    with pytest.raises(ValueError, match=r"no network \(it does not begin as one\): give the path of one"):
        ShapePredictor.load(path)
    write_content(path, {"format": "enn-policy-1"})
    with pytest.raises(ValueError, match="no network of format guide3d-network-1, but 'enn-policy-1': give the path"):
        ShapePredictor.load(path)


@pytest.mark.parametrize("kind", MODELS)
def test_a_model_that_asks_for_more_than_it_holds_is_refused_before_it_is_built(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    first = kind == "shape"
    count = require_refusals(path, lambda: type(model).load(path), forged=first)
    assert count > (50 if first else 12)


def test_weights_that_are_no_numbers_are_neither_written_nor_read(tmp_path: Path) -> None:
    model, path = fgrn(), tmp_path / "model.pt"
    model.save(path)
    before = path.read_bytes()
    next(model.network.parameters()).data.view(-1)[0] = float("inf")
    with pytest.raises(ValueError, match=r"model\.pt was not written: .* is not finite"):
        model.save(path)
    assert path.read_bytes() == before
    content = read_content(path)
    write_content(path, content | {"weights": model.network.state_dict()})
    with pytest.raises(ValueError, match=r"model\.pt: .* is not finite"):
        FGRNPredictor.load(path)


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
            assert (there.width, there.height) == (64, 64)
    assert refused > 100


@pytest.mark.parametrize("kind", MODELS)
def test_files_of_other_versions_are_one_sentence(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    content = read_content(path)
    for name in content:
        for change in ({}, {name: None}, {name: [1]}, {name: {"a": 1}}):
            write_content(path, {key: value for key, value in content.items() if key != name} | change)
            if name == "metadata" and isinstance(change.get(name), dict):
                continue
            with pytest.raises(
                ValueError, match=r"model\.pt is .*(train it again|give the other file|give the path of one)"
            ):
                type(model).load(path)
