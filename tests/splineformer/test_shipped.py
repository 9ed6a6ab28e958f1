"""The shipped network, its export, and real images."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import splineformer
from guide3d import shipped as shelf
from guide3d.learning.model_file import read_content, write_content
from splineformer import shipped
from splineformer.build import VARIANTS, build, size_of
from splineformer.export import export_onnx, onnx_difference
from splineformer.modeling.published import SplineFormerSettings
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


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra splineformer[onnx] is not installed",
)
@pytest.mark.parametrize("variant", VARIANTS)
def test_onnx_agrees_with_torch(variant: str, tmp_path: Path) -> None:
    settings = size_of(variant, "smoke")
    # unrolled: every token is a part of the graph of its own
    model = build(replace(settings, limit=3) if isinstance(settings, SplineFormerSettings) else settings).eval()
    files = export_onnx(model, tmp_path / "model.onnx", batch=2)
    assert max(onnx_difference(model, tmp_path / "model.onnx", batch=2).values()) < 1e-3
    assert sorted(tmp_path.iterdir()) == sorted(files)
