"""ONNX agrees with torch."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

from splineformer.build import VARIANTS, build, size_of
from splineformer.export import export_onnx, onnx_difference
from splineformer.modeling.published import SplineFormerSettings


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
