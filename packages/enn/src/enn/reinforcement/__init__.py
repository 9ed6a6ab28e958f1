"""Reinforcement learning of policies: SAC and PPO from settings to the best policy.

The names below are imported at first use, so that a light module of this folder does not pull in torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from enn.lazy_names import lazy_names

if TYPE_CHECKING:
    from enn.reinforcement.checkpoint import CheckpointError as CheckpointError
    from enn.reinforcement.training import Training as Training
    from enn.reinforcement.training_result import Progress as Progress
    from enn.reinforcement.training_result import TrainingResult as TrainingResult
    from enn.reinforcement.training_settings import DESK_PPO as DESK_PPO
    from enn.reinforcement.training_settings import DESK_SAC as DESK_SAC
    from enn.reinforcement.training_settings import THESIS_PPO as THESIS_PPO
    from enn.reinforcement.training_settings import THESIS_SAC as THESIS_SAC
    from enn.reinforcement.training_settings import TrainingSettings as TrainingSettings

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

__all__ = list(_HOME)
__getattr__ = lazy_names(__name__, _HOME)
