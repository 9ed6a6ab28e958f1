"""Encoded environments: a vector of environments whose observations pass through a frozen encoder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn, VecEnvWrapper

from enn.networks.devices import device_of
from enn.networks.features import require_keys

if TYPE_CHECKING:
    from enn.networks.encoder_network import Encoder

Observations = dict[str, np.ndarray]


class EncodedEnvs(VecEnvWrapper):
    """Observations become `features`.

    Args:
        venv: whose observation is a Dict with the encoder's keys.
        encoder: used without gradients, in evaluation mode.

    Raises:
        ValueError: an observation is missing, or has another shape than the encoder was trained with.
    """

    def __init__(self, venv: VecEnv, encoder: Encoder) -> None:
        self.encoder = encoder
        space = require_keys(venv.observation_space, encoder.keys)
        for key, shape in zip(encoder.keys, encoder.settings.shapes, strict=True):
            if space[key].shape != tuple(shape):
                raise ValueError(
                    f"the encoder was trained with '{key}' of shape {tuple(shape)}, but the environment gives "
                    f"{space[key].shape}: use the same wire and image size"
                )
        encoder.eval()
        self._device = device_of(encoder)
        features = gymnasium.spaces.Box(-np.inf, np.inf, (encoder.settings.features,), np.float32)
        super().__init__(venv, observation_space=gymnasium.spaces.Dict({"features": features}))

    def encode(self, observations: Mapping[str, np.ndarray]) -> Observations:
        """Features of a batch. Shape (n, features)."""
        with torch.inference_mode():
            seen = {
                key: torch.from_numpy(np.ascontiguousarray(observations[key])).to(self._device)
                for key in self.encoder.keys
            }
            return {"features": self.encoder(seen).cpu().numpy()}

    def reset(self) -> Observations:
        """Starts an episode everywhere."""
        observations: Any = self.venv.reset()
        return self.encode(observations)

    def step_wait(self) -> VecEnvStepReturn:
        """Encodes all observations at once, the last ones of episodes that have ended too."""
        observations, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observations, dict)
        ended = [index for index in np.flatnonzero(dones) if "terminal_observation" in infos[index]]
        if not ended:
            return self.encode(observations), rewards, dones, infos
        count, keys = len(rewards), self.encoder.keys
        lasts = [infos[index]["terminal_observation"] for index in ended]
        joined = {key: np.concatenate((observations[key], np.stack([last[key] for last in lasts]))) for key in keys}
        encoded = self.encode(joined)
        for place, index in enumerate(ended):
            last = {key: values[count + place] for key, values in encoded.items()}
            infos[index] = {**infos[index], "terminal_observation": last}
        return {key: values[:count] for key, values in encoded.items()}, rewards, dones, infos
