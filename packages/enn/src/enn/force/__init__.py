"""Prediction of contact forces from what is observed; the names below are imported at first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from enn.force.evaluation import ForceScore, calibration, evaluate_predictor, score
    from enn.force.prediction import (
        DESK_FORCE,
        THESIS_FORCE,
        ForceNetwork,
        ForceNetworkSettings,
        ForcePredictionSettings,
        ForcePredictor,
        fit_force,
        force_preset,
    )
    from enn.force.samples import FORCE_INPUTS, ForceInputs, ForceSamples, force_samples, principal_components

_HOME = {
    "DESK_FORCE": "prediction",
    "FORCE_INPUTS": "samples",
    "THESIS_FORCE": "prediction",
    "ForceInputs": "samples",
    "ForceNetwork": "prediction",
    "ForceNetworkSettings": "prediction",
    "ForcePredictionSettings": "prediction",
    "ForcePredictor": "prediction",
    "ForceSamples": "samples",
    "ForceScore": "evaluation",
    "calibration": "evaluation",
    "evaluate_predictor": "evaluation",
    "fit_force": "prediction",
    "force_preset": "prediction",
    "force_samples": "samples",
    "principal_components": "samples",
    "score": "evaluation",
}

__all__ = [
    "DESK_FORCE",
    "FORCE_INPUTS",
    "THESIS_FORCE",
    "ForceInputs",
    "ForceNetwork",
    "ForceNetworkSettings",
    "ForcePredictionSettings",
    "ForcePredictor",
    "ForceSamples",
    "ForceScore",
    "calibration",
    "evaluate_predictor",
    "fit_force",
    "force_preset",
    "force_samples",
    "principal_components",
    "score",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
