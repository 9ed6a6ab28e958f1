"""Reinforcement learning of policies: SAC and PPO from settings to the best policy.

The names below are imported at first use, so that a light module of this folder does not pull in torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from enn.lazy_names import lazy_names

if TYPE_CHECKING:
    from enn.reinforcement.checkpoint import CheckpointError as CheckpointError
    from enn.reinforcement.training.result import Progress as Progress
    from enn.reinforcement.training.result import TrainingResult as TrainingResult
    from enn.reinforcement.training.settings import DESK_PPO as DESK_PPO
    from enn.reinforcement.training.settings import DESK_SAC as DESK_SAC
    from enn.reinforcement.training.settings import THESIS_PPO as THESIS_PPO
    from enn.reinforcement.training.settings import THESIS_SAC as THESIS_SAC
    from enn.reinforcement.training.settings import PpoSettings as PpoSettings
    from enn.reinforcement.training.settings import SacSettings as SacSettings
    from enn.reinforcement.training.settings import TrainingSettings as TrainingSettings
    from enn.reinforcement.training.training import Training as Training

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "checkpoint": "CheckpointError",
        "training.result": "Progress TrainingResult",
        "training.settings": "DESK_PPO DESK_SAC PpoSettings SacSettings THESIS_PPO THESIS_SAC TrainingSettings",
        "training.training": "Training",
    },
)
