"""Reinforcement learning of policies: SAC and PPO from settings to the best policy.

The names below are imported at first use, so that a light module of this folder does not pull in torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.training import Training
    from enn.reinforcement.training_result import Progress, TrainingResult
    from enn.reinforcement.training_settings import DESK_PPO, DESK_SAC, THESIS_PPO, THESIS_SAC, TrainingSettings

_HOME = {
    "CheckpointError": "checkpoint",
    "DESK_PPO": "training_settings",
    "DESK_SAC": "training_settings",
    "Progress": "training_result",
    "THESIS_PPO": "training_settings",
    "THESIS_SAC": "training_settings",
    "Training": "training",
    "TrainingResult": "training_result",
    "TrainingSettings": "training_settings",
}

__all__ = [
    "DESK_PPO",
    "DESK_SAC",
    "THESIS_PPO",
    "THESIS_SAC",
    "CheckpointError",
    "Progress",
    "Training",
    "TrainingResult",
    "TrainingSettings",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
