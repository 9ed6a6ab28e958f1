"""Networks trained on a drawn data set, what is kept of them, damaged images, two processes; their errors are known."""

import dataclasses
import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch

from guide3d.dataset.dataset import Dataset, split
from guide3d.learning.evaluation import dice, evaluate_segmentation, evaluate_shape
from guide3d.learning.network_training import train_network
from guide3d.learning.picture_store import PictureStore, Preprocessing
from guide3d.learning.predictor import FGRNPredictor, SegmentationPredictor, ShapePredictor
from guide3d.learning.recipes import fgrn_recipe, segmentation_recipe, shape_recipe
from guide3d.learning.shape_samples import clips_of, curve_of, walks_of
from guide3d.train import main
from tests.guide3d.learning.drawn_data import SIDE, draw


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def with_epochs(recipe, epochs: int, **changed):
    return dataclasses.replace(recipe, fit=dataclasses.replace(recipe.fit, epochs=epochs, **changed))


QUICKLY = {"batch_size": 2, "schedule": "constant", "learning_rate": 3e-3}


@pytest.mark.parametrize("form", ["spherical", "cartesian"])
def test_shape_network_learns_and_is_kept(data: Dataset, tmp_path: Path, form: str) -> None:
    recipe = with_epochs(shape_recipe("smoke"), 8, **QUICKLY)
    predictor, report = train_network(data, split(data), recipe, form, folder=tmp_path / "fit")
    assert report.rows[-1]["loss"] < 0.7 * report.rows[0]["loss"]
    frame = data.frames[2]
    images = [data.frames[index].image("a") for index in range(3)]
    curve = predictor.predict(images)
    assert curve.shape[1] == 3
    assert np.linalg.norm(curve[0] - curve_of(frame)[0]) < 40  # mm: in the drawn scene, not in pixels
    if form == "spherical":
        # led to the tip, every step is one of 1.7 mm and the same share of the gap
        network, pictures = predictor.network, np.stack([predictor.preprocessing(image) for image in images])
        with torch.no_grad():
            told = network(torch.from_numpy(pictures[None].astype(np.float32))).offsets
        own = network.form.steps(told)[0, : len(curve) - 1].flip(0).numpy()
        assert np.linalg.norm(own, axis=1) == pytest.approx(1.7, abs=1e-3)
        shares = np.diff(curve, axis=0) - own
        assert shares == pytest.approx(np.broadcast_to(shares.mean(axis=0), shares.shape), abs=1e-3)
    predictor.save(tmp_path / "shape.pt")
    again = ShapePredictor.load(tmp_path / "shape.pt")
    assert again.preprocessing == predictor.preprocessing
    assert again.preprocessing.source_px == 128
    assert np.array_equal(again.predict(images), curve)
    # one frame is as good as that frame three times
    assert np.array_equal(again.predict(images[:1]), again.predict([images[0]] * 3))
    with pytest.raises(ValueError, match="expected an image of 128 x 128 px"):
        again.predict([np.zeros((64, 64), np.uint8)])
    with pytest.raises(ValueError, match="expected at least one image"):
        again.predict([])
    with pytest.raises(ValueError, match="a network of kind 'shape', expected fgrn"):
        FGRNPredictor.load(tmp_path / "shape.pt")


def test_fgrn_learns_and_is_kept(data: Dataset, tmp_path: Path) -> None:
    recipe = with_epochs(fgrn_recipe("smoke"), 8, **QUICKLY)
    predictor, report = train_network(data, split(data), recipe, folder=tmp_path / "fit")
    assert report.rows[-1]["loss"] < 0.8 * report.rows[0]["loss"]
    predictor.save(tmp_path / "fgrn.pt")
    image = data.frames[0].image("a")
    points = FGRNPredictor.load(tmp_path / "fgrn.pt").predict(image)
    assert points.shape == (predictor.network.points, 3)
    assert np.array_equal(points, predictor.predict(image))


def test_a_segmenter_learns_and_is_kept(data: Dataset, tmp_path: Path) -> None:
    recipe = dataclasses.replace(with_epochs(segmentation_recipe("unet", "smoke"), 8, **QUICKLY), images=0, mask_px=2.0)
    predictor, _ = train_network(data, split(data), recipe, folder=tmp_path / "fit")
    frame = data.frames[-1]
    mask = predictor.predict(frame.image("b"))
    assert mask.shape == (128, 128)
    assert set(np.unique(mask)) <= {0, 255}
    assert dice(mask, frame.mask("b", 2.0)) > 0.6
    predictor.save(tmp_path / "unet.pt")
    again = SegmentationPredictor.load(tmp_path / "unet.pt")
    assert np.array_equal(again.predict(frame.image("b")), mask)
    with pytest.raises(FileNotFoundError, match="there is no network"):
        SegmentationPredictor.load(tmp_path / "none.pt")


@pytest.mark.parametrize("name", ["transunet", "swinunet"])
def test_the_others_train_too(data: Dataset, tmp_path: Path, name: str) -> None:
    predictor, report = train_network(data, split(data), segmentation_recipe(name, "smoke"), folder=tmp_path)
    assert len(report.rows) == 1
    assert predictor.predict(data.frames[0].image("a")).shape == (128, 128)


def test_a_damaged_image_is_skipped_once_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = draw(tmp_path / "drawn")
    parts = split(data)
    broken = data.frames[data.acquisitions[parts.train[0]][1]]
    for camera in "ab":
        file = broken.image_path(camera)
        file.write_bytes(file.read_bytes()[:200])
    segmenter = dataclasses.replace(segmentation_recipe("unet", "smoke"), images=0)
    for recipe, count in ((shape_recipe("smoke"), 1), (segmenter, 2)):  # of segmenters both cameras, once each
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            _, report = train_network(data, parts, with_epochs(recipe, 2), "spherical", folder=tmp_path / str(count))
        assert len(report.rows) == 2
        told = [record.getMessage() for record in caplog.records if "is skipped" in record.getMessage()]
        assert len(told) == count
        assert broken.label in told[0]
    for frame in data.frames:
        frame.image_path("a").write_bytes(b"")
    caplog.clear()
    store = PictureStore(data.frames, "a", Preprocessing(32, 128))
    with caplog.at_level(logging.WARNING):
        assert not store.healthy(np.arange(len(data.frames))).any()
    assert len(caplog.records) == 5 + 1 < len(data.frames)  # five by name, and that there are more
    assert data.frames[4].label in caplog.records[4].getMessage()
    with pytest.raises(ValueError, match="images cannot be read, the first of frame"):
        train_network(data, parts, shape_recipe("smoke"), "spherical", folder=tmp_path / "none")


def test_prepared_pictures_are_shared_and_a_mended_image_is_read_again(data: Dataset, tmp_path: Path) -> None:
    told = Preprocessing(32, 128, line_px=7)
    first = PictureStore(data.frames, "a", told, tmp_path)
    some = np.array([[0, 3], [5, 0]])
    pictures = first.pictures(some)
    assert pictures.shape == (2, 2, 32, 32)
    assert np.array_equal(pictures[0, 1], told(data.frames[3].image("a")))
    second = PictureStore(data.frames, "a", told, tmp_path)
    assert np.array_equal(second._pictures[3], pictures[0, 1])  # not read again
    second._state[7] = 2
    assert PictureStore(data.frames, "a", told, tmp_path).healthy(np.array([7])).all()
    other = PictureStore(data.frames, "a", Preprocessing(32, 128), tmp_path)
    assert not np.array_equal(other.pictures(np.array([3]))[0], pictures[0, 1])


def test_clips_hold_windows_in_time_order(data: Dataset) -> None:
    walks = walks_of(data, 2.0)
    name = next(iter(data.acquisitions))
    order = data.acquisitions[name]
    single = clips_of(data, [name], walks, 3, 1)
    assert single.frames.tolist() == [
        [order[0]] * 3, [order[0], order[0], order[1]], order[:3], order[1:4],
    ]  # fmt: skip
    assert single.targets[:, 0].tolist() == order
    pairs = clips_of(data, [name], walks, 3, 3)
    assert pairs.frames.tolist() == [[order[0], order[0], *order[:3]], [order[1], order[2], *order[3:4] * 3]]
    del walks[order[1]]  # a frame without a curve is seen, not predicted
    holes = clips_of(data, [name], walks, 3, 2)
    assert order[1] not in holes.targets
    assert order[1] in holes.frames


def test_command_line_refuses_in_a_sentence(
    data: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "none"), "--network", "unet", "--output", str(tmp_path)]) == 2
    assert "is missing" in caplog.records[-1].getMessage()
    for option, text, sentence in (
        ("--settings", '{"sizes": {"layers": 3}}', "unet cannot have the sizes {'layers': 3}"),
        ("--settings", '{"fit": {"epochs": 2}}', "--settings: the fields of the fit are given by --fit"),
        ("--settings", '{"crop_px": 1024}', "crop_px=1024: expected a multiple of"),
        ("--fit", '{"rate": 1}', "rate Unexpected keyword argument, got 1"),
    ):
        words = [str(data.root), "--network", "unet", "--size", "smoke", "--output", str(tmp_path / "fit")]
        assert main([*words, option, text]) == 2
        assert sentence in caplog.records[-1].getMessage()
    with pytest.raises(SystemExit):
        main([*words, "--fit", "[1]"])
    assert "expected a JSON object of fields" in capsys.readouterr().err


def test_the_command_line_changes_recipe_and_fit(data: Dataset, tmp_path: Path) -> None:
    words = [str(data.root), "--network", "unet", "--size", "smoke", "--output", str(tmp_path)]
    changed = ["--settings", '{"sizes": {"widths": [2, 4], "kind": "none"}}', "--fit", '{"epochs": 2}']
    assert main([*words, *changed]) == 0
    network = SegmentationPredictor.load(tmp_path / "predictor.pt").network
    assert next(network.parameters()).shape[0] == 2
    assert len(json.loads((tmp_path / "training.json").read_text())["rows"]) == 2


@pytest.mark.slow
def test_two_processes_train_together(data: Dataset, tmp_path: Path) -> None:
    words = [str(data.root), "--network", "spherical", "--size", "smoke", "--epochs", "2", "--device", "cpu"]
    done = subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "guide3d.train",
         *words, "--output", str(tmp_path)],
        capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads((tmp_path / "training.json").read_text())
    assert (told["processes"], len(told["rows"])) == (2, 2)
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["predictor.pt", "training.json"]
    ShapePredictor.load(tmp_path / "predictor.pt")


@pytest.mark.parametrize("overtaken_at", [1, 2])
def test_a_store_made_by_two_processes_at_once_never_gives_an_empty_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overtaken_at: int
) -> None:
    data, preprocessing = draw(tmp_path / "drawn", acquisitions=2, frames=2), Preprocessing(32, 128)
    others: list[PictureStore] = []
    targets: list[Path] = []
    replace = os.replace

    def overtaken(source: Path, target: Path) -> None:
        """Lets another process make its store just before one of this one's files appears."""
        targets.append(target)
        if len(targets) != overtaken_at:
            replace(source, target)
            return
        aside = target.with_name("aside")
        replace(source, aside)  # two processes name their temporary files differently
        with monkeypatch.context() as undone:
            undone.setattr(os, "replace", replace)
            others.append(PictureStore(data.frames, "a", preprocessing, tmp_path / "pictures"))
        replace(aside, target)

    monkeypatch.setattr(os, "replace", overtaken)
    store = PictureStore(data.frames, "a", preprocessing, tmp_path / "pictures")
    indices = np.arange(len(data.frames))
    expected = np.stack([preprocessing(frame.image("a")) for frame in data.frames])
    for one in [*others, store]:
        assert np.array_equal(one.pictures(indices), expected)


class _TrueShape:
    """Predicts the true curves of an acquisition in its order, moved along x."""

    preprocessing = Preprocessing(32, SIDE)
    network = type("Network", (), {"frames": 1})
    metadata: ClassVar[dict[str, Any]] = {}

    def __init__(self, curves: list[np.ndarray]) -> None:
        self.curves = curves

    def predict_pictures(self, windows: np.ndarray) -> list[np.ndarray]:
        assert len(windows) == len(self.curves)
        return self.curves

    def predict(self, images: list[np.ndarray]) -> np.ndarray:
        assert images[0].shape == (SIDE, SIDE)
        return self.curves[0]


class _TrueMask:
    """Predicts the true masks of images in the order in which they are asked for, or their opposite."""

    metadata: ClassVar[dict[str, Any]] = {"mask_px": 4.0}
    preprocessing = Preprocessing(SIDE, SIDE)

    def __init__(self, data: Dataset, wrong: bool) -> None:
        self.data, self.wrong = data, wrong

    def chances(self, picture: np.ndarray) -> np.ndarray:
        own = next(f.mask(v, 4.0) for f in self.data.frames for v in "ab" if np.array_equal(f.image(v), picture)) > 0
        return (own != self.wrong).astype(np.float32)

    def enlarged(self, chances: np.ndarray) -> np.ndarray:
        return chances

    def predict(self, image: np.ndarray) -> np.ndarray:
        return 255 * self.chances(image).astype(np.uint8)


def test_shapes_that_are_moved_are_off_by_as_much(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    name = next(iter(data.acquisitions))
    curves = [data.frames[index].curve_mm for index in data.acquisitions[name]]
    figures, examples = evaluate_shape(_TrueShape([c + np.array([2.0, 0.0, 0.0]) for c in curves]), data, [name])  # type: ignore[arg-type]
    assert figures["frames"] == len(curves)
    for metric in ("max_ed", "mers", "frechet"):
        assert figures[metric] == pytest.approx([2.0, 0.0], abs=1e-6)
    assert figures["length_error_mm"][0] == pytest.approx(0.0, abs=1e-9)
    assert figures["along_error_mm"] == pytest.approx([2.0] * len(figures["along_mm"]), abs=1e-6)
    assert figures["reprojection_px"][0] > 0.2
    monkeypatch.setattr(Dataset, "undistort", lambda self, camera, points: points + 50.0)
    undistorted, _ = evaluate_shape(_TrueShape(curves), data, [name])  # type: ignore[arg-type]
    assert undistorted["reprojection_px"][0] > 20  # the annotation is undistorted as the camera is
    assert set(examples) == {"frames"} | {f"{what}{k}" for what in ("predicted", "true") for k in range(3)}
    assert set(examples["frames"]) <= set(data.acquisitions[name])


def test_masks_that_are_right_and_wrong(data: Dataset) -> None:
    name = next(iter(data.acquisitions))
    calls: list[tuple[int, int]] = []
    true: Any = _TrueMask(data, False)
    right, examples = evaluate_segmentation(true, data, [name], images=3, progress=lambda *call: calls.append(call))
    assert right["images"] == 3
    assert calls == [(0, 3), (1, 3), (2, 3)]
    assert right["dice"] == right["miou"] == [100.0, 0.0]
    assert list(right["by_kind"].values()) == [[100.0, 0.0]]
    assert np.array_equal(examples["true1"] > 0, examples["predicted1"] > 0)
    wrong, _ = evaluate_segmentation(_TrueMask(data, True), data, [name], images=3)  # type: ignore[arg-type]
    assert wrong["dice"] == wrong["miou"] == [0.0, 0.0]
