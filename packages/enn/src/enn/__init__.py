"""Expert Navigation Network: learned policies for endovascular navigation that reach the simulator through Gymnasium.

Names below are imported at first use: `import enn` alone pulls in neither torch nor stable-baselines3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from enn.lazy_names import lazy_names

if TYPE_CHECKING:
    from enn.encoder import Encoder as Encoder
    from enn.encoder import EncoderSettings as EncoderSettings
    from enn.encoder import Samples as Samples
    from enn.encoder import fit_encoder as fit_encoder
    from enn.encoder import scripted_samples as scripted_samples
    from enn.networks.features import MultimodalExtractor as MultimodalExtractor
    from enn.networks.features import layer_table as layer_table
    from enn.networks.observation_spaces import modality_keys as modality_keys
    from enn.policy import Policy as Policy
    from enn.reinforcement.encoded import EncodedEnvs as EncodedEnvs
    from enn.reinforcement.training.settings import TrainingSettings as TrainingSettings
    from enn.reinforcement.training.training import Training as Training
    from enn.shipped import load as load
    from enn.shipped import models as models
    from enn.trajectory import Trajectory as Trajectory

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "encoder": "Encoder EncoderSettings Samples fit_encoder scripted_samples",
        "networks.features": "MultimodalExtractor layer_table",
        "networks.observation_spaces": "modality_keys",
        "policy": "Policy",
        "reinforcement.encoded": "EncodedEnvs",
        "reinforcement.training.training": "Training",
        "reinforcement.training.settings": "TrainingSettings",
        "shipped": "load models",
        "trajectory": "Trajectory",
    },
)
