"""Shipped networks of splineformer: found by name, and refused in one sentence where they cannot be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import splineformer
from guide3d import shipped as shelf
from guide3d.learning.model_file import read_content, write_content
from splineformer import shipped
from splineformer.build import build, size_of
from splineformer.predictor import Predictor
from tests.splineformer.curves import image_of, wavy_wire


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the installed weights, with an untrained network of the shipped variant."""
    monkeypatch.setattr(shelf, "files", lambda package: tmp_path / package)
    weights = tmp_path / "splineformer.weights"
    weights.mkdir()
    torch.manual_seed(0)
    Predictor(build(size_of("ordered", "smoke")), source_px=256).save(weights / "ordered.pt")
    (weights / "ordered.md").write_text("# ordered\n\nReads a wire.\n\nmore\n")
    return weights


def test_the_shipped_network_predicts(folder: Path) -> None:
    assert splineformer.models() == {"ordered": "Reads a wire."}
    assert shipped.card("ordered").startswith("# ordered")
    image = image_of(wavy_wire(0))
    own, loaded = Predictor.load(folder / "ordered.pt"), Predictor.pretrained()
    assert loaded.source_px == 256
    assert own(image).wires == loaded(image).wires
    assert np.isclose(own(image).confidence, loaded(image).confidence)


def test_another_format_or_name_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="there is no model 'published': choose from ordered"):
        Predictor.pretrained("published")
    file = folder / "ordered.pt"
    write_content(file, {**read_content(file), "format": "guide3d-network-0"})
    with pytest.raises(ValueError, match=r"'ordered' has format guide3d-network-0, but splineformer 0\.1\.0 reads"):
        Predictor.pretrained()
