"""SplineFormer: a transformer that reads a guidewire as a B-spline from one fluoroscopic image.

``Predictor.load(path)(image)`` gives the curve. Names are imported when they are first asked for, so that
``import splineformer`` itself stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from splineformer.attention import attention_map as attention_map
    from splineformer.comparison.evaluation import curve_errors as curve_errors
    from splineformer.export import export_onnx as export_onnx
    from splineformer.learning.recipes import recipe_of as recipe_of
    from splineformer.learning.training import train as train
    from splineformer.predictor import Prediction as Prediction
    from splineformer.predictor import Predictor as Predictor
    from splineformer.shipped import models as models
    from splineformer.tokens import curve_of_tokens as curve_of_tokens
    from splineformer.tokens import tokens_of_polyline as tokens_of_polyline

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "attention": "attention_map",
        "comparison.evaluation": "curve_errors",
        "export": "export_onnx",
        "learning.recipes": "recipe_of",
        "learning.training": "train",
        "predictor": "Prediction Predictor",
        "shipped": "models",
        "tokens": "curve_of_tokens tokens_of_polyline",
    },
)
