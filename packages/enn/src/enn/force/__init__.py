"""Prediction of contact forces from what is observed; the names below are imported at first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from enn.lazy_names import lazy_names

if TYPE_CHECKING:
    from enn.force.evaluation import ForceScore as ForceScore
    from enn.force.evaluation import calibration as calibration
    from enn.force.evaluation import evaluate_predictor as evaluate_predictor
    from enn.force.evaluation import score as score
    from enn.force.prediction import DESK_FORCE as DESK_FORCE
    from enn.force.prediction import THESIS_FORCE as THESIS_FORCE
    from enn.force.prediction import ForceNetwork as ForceNetwork
    from enn.force.prediction import ForceNetworkSettings as ForceNetworkSettings
    from enn.force.prediction import ForcePredictionSettings as ForcePredictionSettings
    from enn.force.prediction import ForcePredictor as ForcePredictor
    from enn.force.prediction import fit_force as fit_force
    from enn.force.prediction import force_preset as force_preset
    from enn.force.samples import FORCE_INPUTS as FORCE_INPUTS
    from enn.force.samples import ForceInputs as ForceInputs
    from enn.force.samples import ForceSamples as ForceSamples
    from enn.force.samples import force_samples as force_samples
    from enn.force.samples import principal_components as principal_components

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "evaluation": "ForceScore calibration evaluate_predictor score",
        "prediction": "DESK_FORCE ForceNetwork ForceNetworkSettings ForcePredictionSettings ForcePredictor "
        "THESIS_FORCE fit_force force_preset",
        "samples": "FORCE_INPUTS ForceInputs ForceSamples force_samples principal_components",
    },
)
