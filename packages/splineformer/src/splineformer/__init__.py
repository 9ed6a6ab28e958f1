"""SplineFormer: a transformer that reads a guidewire as a B-spline from one fluoroscopic image.

``Predictor.load(path)(image)`` gives the curve. Names are imported when they are first asked for, so that
``import splineformer`` itself stays light.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Predictor": "splineformer.predictor",
    "Prediction": "splineformer.predictor",
    "TokenSettings": "splineformer.tokens",
    "tokens_of_polyline": "splineformer.tokens",
    "curve_of_tokens": "splineformer.tokens",
    "curve_errors": "splineformer.comparison.curve_errors",
    "attention_map": "splineformer.attention",
    "export_onnx": "splineformer.export",
    "models": "splineformer.shipped",
    "recipe_of": "splineformer.learning.recipes",
    "train": "splineformer.learning.training",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'splineformer' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
