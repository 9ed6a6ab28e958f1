"""The commands that train leave a network, or refuse in one sentence."""

import json
from pathlib import Path

import numpy as np
import pytest

from splineformer.learning.training_command import main as command
from splineformer.predictor import Predictor
from splineformer.train_on_fluoroscopy import main
from tests.guide3d.learning.drawn_data import draw
from tests.splineformer.curves import image_of, wavy_wire


@pytest.mark.parametrize(
    "more", [("--epochs", "0"), ("--epochs", "10000000000000"), ("--calibration", "{none}"), ("--output", "{file}")]
)
def test_command_refuses_with_one_sentence(
    more: tuple[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    draw(tmp_path)
    (tmp_path / "file").write_text("no folder")
    words = [str(tmp_path), "--variant", "ordered", "--size", "smoke", "--device", "cpu", "--output", str(tmp_path)]
    given = [word.format(none=tmp_path / "none", file=tmp_path / "file") for word in more]
    with caplog.at_level("ERROR"):
        assert command([*words, *given]) == 2
    messages = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(messages) == 1
    assert "\n" not in messages[0]
    with pytest.raises(SystemExit):
        command([*words, "--seed=-1"])


SMALL = '{"images": 2, "validation_images": 2, "samples": 8}'


def test_the_command_leaves_a_network_that_reads(tmp_path: Path) -> None:
    words = ["--size", "smoke", "--output", str(tmp_path), "--epochs", "1", "--test-images", "1", "--device", "cpu"]
    assert main([*words, "--settings", SMALL]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["predictor.pt", "training.json"]
    table = json.loads((tmp_path / "training.json").read_text())
    assert table["recipe"]["input"] == "maps"
    assert len(table["rows"]) == 1
    assert table["test"]["images"] + table["test"]["empty"] <= 1
    predictor = Predictor.load(tmp_path / "predictor.pt")
    assert predictor.input == "maps"
    image = image_of(wavy_wire(0))
    prediction = predictor(image)
    assert prediction.wires in ("none", "one", "several")
    if prediction.tokens is not None:
        assert np.isfinite(prediction.points()).all()
    assert predictor.picture(image).pixels.shape == (64, 64)


@pytest.mark.parametrize(
    "more",
    [("--epochs", "0"), ("--settings", '{"sample": 3}'), ("--fluoroscopy", '{"noise": -1}'), ("--output", "{file}")],
)
def test_the_command_refuses_with_one_sentence(
    more: tuple[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("no folder")
    words = ["--size", "smoke", "--device", "cpu", "--output", str(tmp_path / "out"), "--settings", SMALL]
    with caplog.at_level("ERROR"):
        assert (
            main([*words, *(word.format(file=tmp_path / "file") if "{file}" in word else word for word in more)]) == 2
        )
    messages = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(messages) == 1
    assert "\n" not in messages[0]
