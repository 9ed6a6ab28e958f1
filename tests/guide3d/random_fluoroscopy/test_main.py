"""Images along a data set's wires: dark where the annotation says, under the same names, and open to every training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.dataset import Dataset
from guide3d.random_fluoroscopy.__main__ import RECORD, main
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from tests.guide3d.learning.drawn_data import SIDE, draw

CLEAN = '{"clutter": 1e-6, "catheter": 0, "along_edge": 0, "in_vessel": 0, "narrowest_px": 4.0, "noise": 0.31}'


def test_images_lie_along_the_annotation(tmp_path: Path) -> None:
    draw(tmp_path / "data", acquisitions=2, frames=2)
    assert main([str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--settings", CLEAN]) == 0
    data = Dataset.open(tmp_path / "data", images=tmp_path / "new")
    darker = []
    for frame in data.frames:
        for camera in "ab":
            image = frame.image(camera)
            assert image.shape == (SIDE, SIDE)
            line = frame.polyline(camera)
            line = line[((line > 1) & (line < SIDE - 2)).all(axis=1)]
            x, y = np.rint(line).astype(int).T
            around = [image[np.clip(y + d, 0, SIDE - 1), np.clip(x + e, 0, SIDE - 1)] for d, e in ((4, 0), (0, 4))]
            darker.append(np.median(image[y, x].astype(float) / np.maximum(np.max(around, axis=0), 1)))
    assert np.median(darker) < 0.97


def test_a_second_run_keeps_what_is_there(tmp_path: Path) -> None:
    draw(tmp_path / "data", acquisitions=1, frames=2)
    words = [str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--frames", "1", "--settings", CLEAN]
    main(words)
    (first, second) = sorted((tmp_path / "new").rglob("*.png"))
    before = first.stat().st_mtime_ns, second.read_bytes()
    second.unlink()
    main(words)
    assert (first.stat().st_mtime_ns, second.read_bytes()) == before


def test_bad_settings_are_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw(tmp_path / "data", acquisitions=1, frames=1)
    words = [str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--settings"]
    assert main([*words, '{"noise": -3}']) == 2
    assert "noise" in capsys.readouterr().err
    for text in ("[1]", "{"):
        with pytest.raises(SystemExit, match="2"):
            main([*words, text])
        assert "expected a JSON object of fields" in capsys.readouterr().err
    assert main([*words, '{"noises": 3}']) == 2
    assert "'noises' is unknown: expected fields among" in capsys.readouterr().err


def test_images_of_another_kind_are_not_mixed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw(tmp_path / "data", acquisitions=1, frames=1)
    words = [str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--settings"]
    assert main([*words, CLEAN]) == 0
    assert main([*words, CLEAN, "--seed", "1"]) == 2
    assert "holds images of another seed" in capsys.readouterr().err
    (tmp_path / "new" / RECORD).unlink()
    assert main([*words, CLEAN]) == 2
    assert "not of random fluoroscopy" in capsys.readouterr().err


def test_wires_must_be_polylines() -> None:
    with pytest.raises(ValueError, match=r"a wire must be \(n, 2\) px"):
        RandomFluoroscopy().along(0, [np.zeros((4, 3))])
