"""Shipped networks: found by name, each read by its class, refused in one sentence where they cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import guide3d
from guide3d import shipped
from guide3d.learning.model_file import read_content, write_content
from guide3d.reading.maps import Reader

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


def test_models_are_listed_with_what_they_do(folder: Path) -> None:
    assert guide3d.models() == {"reader": "Reads wires."}
    assert isinstance(guide3d.load("reader"), Reader)


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


def rename_format(path: Path) -> None:
    write_content(path, {**read_content(path), "format": "guide3d-network-0"})


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def test_kinds_and_formats_are_refused_by_name(folder: Path) -> None:
    refusals: list[tuple[Callable[[Path], None], str]] = [
        (rename_format, r"'reader' has format guide3d-network-0, but guide3d 0\.1\.0 reads guide3d-network-1: install"),
        (cut, "reader.pt is damaged or no network"),
    ]
    for change, message in refusals:
        change(folder / "reader.pt")
        with pytest.raises(ValueError, match=message):
            guide3d.load("reader")


@pytest.mark.parametrize("use", [guide3d.load, shipped.card])
def test_an_unknown_name_is_refused_with_the_known_ones(folder: Path, use: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match="there is no model 'unet9': choose from reader"):
        use("unet9")
