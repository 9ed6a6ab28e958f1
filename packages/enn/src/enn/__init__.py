"""Expert Navigation Network: learned policies for endovascular navigation that reach the simulator through Gymnasium.

Names below are imported at first use: `import enn` alone pulls in neither torch nor stable-baselines3.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from enn.encoder import Encoder, EncoderSettings, Samples, fit_encoder, scripted_samples
    from enn.networks.features import MultimodalExtractor, layer_table, modality_keys
    from enn.networks.policies import AsymmetricSACPolicy
    from enn.policy import Policy
    from enn.reinforcement.encoded import EncodedEnvs
    from enn.reinforcement.training import Training
    from enn.reinforcement.training_settings import TrainingSettings
    from enn.trajectory import Trajectory

__version__ = "0.1.0"

_HOME = {
    "AsymmetricSACPolicy": "networks.policies",
    "EncodedEnvs": "reinforcement.encoded",
    "Encoder": "encoder",
    "EncoderSettings": "encoder",
    "MultimodalExtractor": "networks.features",
    "Policy": "policy",
    "Samples": "encoder",
    "Training": "reinforcement.training",
    "TrainingSettings": "reinforcement.training_settings",
    "Trajectory": "trajectory",
    "fit_encoder": "encoder",
    "layer_table": "networks.features",
    "modality_keys": "networks.features",
    "scripted_samples": "encoder",
}

__all__ = [
    "AsymmetricSACPolicy",
    "EncodedEnvs",
    "Encoder",
    "EncoderSettings",
    "MultimodalExtractor",
    "Policy",
    "Samples",
    "Training",
    "TrainingSettings",
    "Trajectory",
    "__version__",
    "fit_encoder",
    "layer_table",
    "modality_keys",
    "scripted_samples",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"enn.{_HOME[name]}"), name)
    raise AttributeError(f"module 'enn' has no attribute '{name}'")
