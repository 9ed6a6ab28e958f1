"""The reader is trained, calibrated and measured."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.reader.evaluation import evaluate_reader, fitted
from guide3d.learning.reader.training import ReaderRecipe, smoke_recipe, train_reader
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.maps import Reader, ReaderMaps
from guide3d.train_reader import arguments, curves_of, main, train
from tests.guide3d.learning.drawn_data import draw

SMALL = FluoroscopySettings(image_px=128)


def small_recipe(steps: int) -> ReaderRecipe:
    return replace(smoke_recipe(), steps=steps, fluoroscopy=SMALL)


def test_the_loss_falls(tmp_path: Path) -> None:
    losses: list[float] = []
    plain = replace(SMALL, no_wire=0.0, clutter=1e-6, catheter=0.0, along_edge=0.0, in_vessel=0.0, weakest=0.6)
    recipe = replace(small_recipe(60), learning_rate=1e-2, tile_px=32, warm_up=0.0, fluoroscopy=plain)
    train_reader(recipe, tmp_path, processes=0, progress=lambda _, loss: losses.append(loss))
    assert losses[-1] < 0.8 * losses[0]


def test_a_training_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guide3d.learning.reader.training._KEPT_EVERY_S", 0.0)
    whole, _ = train_reader(small_recipe(4), tmp_path / "whole", processes=0)
    told: list[int] = []

    def stop(step: int, _: float) -> None:
        told.append(step)
        if told == [1, 2, 3]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_reader(small_recipe(4), tmp_path / "half", processes=0, progress=stop)
    again, report = train_reader(small_recipe(4), tmp_path / "half", processes=0, progress=stop)
    assert told == [1, 2, 3, 3, 4]  # what was kept last is of the second step
    assert report["steps"] == 4
    for name, value in whole.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value)


def test_a_checkpoint_of_other_courses_is_refused(tmp_path: Path) -> None:
    courses = [np.stack([np.linspace(0.0, 100.0, 50)] * 2, axis=1)]
    train_reader(small_recipe(2), tmp_path, processes=0, courses=courses)
    with pytest.raises(ValueError, match="other settings"):
        train_reader(small_recipe(2), tmp_path, processes=0, courses=[1.1 * courses[0]])


def test_command_line_writes_a_reader(tmp_path: Path) -> None:
    words = ["--output", str(tmp_path / "a"), "--size", "smoke", "--steps", "2", "--images", "1", "--processes", "0"]
    np.savez(tmp_path / "ct.npz", ct=np.zeros((40, 40), np.float32))
    words += ["--fluoroscopy", '{"image_px": 128}', "--backgrounds", str(tmp_path / "ct.npz")]
    table = train(arguments(words))
    assert table["validation"]["images"] == 1
    assert json.loads((tmp_path / "a" / "training.json").read_text())["steps"] == 2
    maps = Reader.load(tmp_path / "a" / "reader.pt").maps(np.full((50, 70), 90, np.uint8))
    assert maps.wire.shape == (50, 70)


def test_curves_of_a_data_set_are_courses(tmp_path: Path) -> None:
    data = draw(tmp_path, acquisitions=2, frames=1)
    curves = curves_of(tmp_path)
    assert len(curves) == 2 * len(data.frames)
    np.testing.assert_allclose(curves[0], data.frames[0].polyline("a") * 1024 / 128)
    RandomFluoroscopy(SMALL, 0, curves).tile(0, 64)


def test_bad_commands_are_refused_in_one_sentence(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.savez_compressed(tmp_path / "whole.npz", ct=np.random.default_rng(0).random((40, 40)))
    np.save(tmp_path / "one.npy", np.zeros((4, 4)))
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "torn.npz").write_bytes(whole[:-40])
    way = whole.rindex(b"PK\x01\x02") + 10  # of compression
    (tmp_path / "odd.npz").write_bytes(whole[:way] + b"c" + whole[way + 1 :])
    broken = ("one.npy", "torn.npz", "odd.npz")
    for option, value, told in (
        *(("--backgrounds", str(tmp_path / name), "is no .npz of arrays") for name in broken),
        ("--images", "0", "--images: expected at least 1 to evaluate with, got 0"),
        ("--settings", '{"fluoroscopy": {}}', "the fields of the random images are given by --fluoroscopy"),
    ):
        assert main(["--output", str(tmp_path / "a"), "--size", "smoke", option, value]) == 2
        assert told in caplog.records[-1].getMessage()
    start = {"other": torch.zeros(3)}
    with pytest.raises(ValueError, match="the weights to start from are of another network"):
        train_reader(small_recipe(1), tmp_path, processes=0, start=start)


def test_evaluation_counts_what_is_marked() -> None:
    class Perfect(Reader):
        def __init__(self, images: RandomFluoroscopy) -> None:
            self.drawn = {image.image.tobytes(): image for image in map(images.image, range(4))}

        def maps(self, image):  # type: ignore[no-untyped-def]
            drawn = self.drawn[image.tobytes()]
            return ReaderMaps(drawn.wire / np.float32(255), drawn.catheter / np.float32(255), drawn.tip)

    fluoroscopy = RandomFluoroscopy(replace(SMALL, image_px=256), seed=4)
    scores = evaluate_reader(Perfect(fluoroscopy), fluoroscopy, range(4))
    assert (scores.dice, scores.precision, scores.recall, scores.tip_found) == (1.0, 1.0, 1.0, 1.0)
    assert (scores.tip_false, scores.empty_px) == (0.0, 0.0)
    assert scores.calibration < 1e-6


def test_scale_and_shift_are_found() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(-1, 3, 40_000)
    truth = (rng.random(40_000) < 1 / (1 + np.exp(-(0.5 * logits - 1.2)))).astype(float)
    scale, shift = fitted(logits, truth)
    assert abs(scale - 0.5) < 0.02
    assert abs(shift + 1.2) < 0.05
