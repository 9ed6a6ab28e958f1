"""Normalised vectors: a features extractor whose mean and scale are fitted once and belong to the network."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from enn.networks.observation_spaces import vector_spaces

LIMIT = 10.0  # normalised values are cut here: what hardly varied while fitting may jump later
SMALLEST_SCALE = 1e-6
_LEAST_SPREAD = 1e-4


class VectorExtractor(BaseFeaturesExtractor):
    """Vector observations side by side, each value less its mean and over its standard deviation.

    Mean 0 and scale 1 until `fit`; both are buffers, so that they are saved with the network.

    Args:
        keys: the observations of a `Dict` to use, in this order; none: all.

    Raises:
        ValueError: a key that there is not, or an image among them.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, observation_space: gymnasium.Space, keys: Sequence[str] = ()) -> None:
        spaces = vector_spaces(observation_space, keys)
        super().__init__(observation_space, sum(map(gymnasium.spaces.flatdim, spaces.values())))
        self.keys = tuple(spaces)
        self.register_buffer("mean", torch.zeros(self.features_dim))
        self.register_buffer("scale", torch.ones(self.features_dim))
        self.fitted = False

    def forward(self, observations: dict[str, Tensor] | Tensor) -> Tensor:
        """Features of observations. Shape (N, features)."""
        vectors = self._vectors(observations)
        if not self.fitted:
            return vectors
        return ((vectors - self.mean) / self.scale).clamp(-LIMIT, LIMIT)

    def fit(self, observations: dict[str, Tensor] | Tensor) -> None:
        """Takes mean and scale from observations; values that do not vary are only shifted.

        Args:
            observations: name to (N, ...), or (N, ...).
        """
        vectors = self._vectors(observations)
        scale = vectors.std(dim=0)
        self.mean.copy_(vectors.mean(dim=0))
        self.scale.copy_(torch.where(scale > SMALLEST_SCALE, scale, torch.ones_like(scale)))
        self.fitted = True

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *rest: object) -> None:
        super()._load_from_state_dict(state_dict, prefix, *rest)
        self.fitted = bool((self.scale != 1).any() or (self.mean != 0).any())

    def _vectors(self, observations: dict[str, Tensor] | Tensor) -> Tensor:
        if not isinstance(observations, dict):
            return observations.flatten(1)
        if len(self.keys) == 1:
            return observations[self.keys[0]].flatten(1)
        return torch.cat([observations[key].flatten(1) for key in self.keys], dim=1)


def fit_normalisation(network: nn.Module, observations: dict[str, Tensor] | Tensor) -> None:
    """Fits every `VectorExtractor` of a network to the same observations."""
    for module in network.modules():
        if isinstance(module, VectorExtractor):
            module.fit(observations)


def standardised(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Features that are to be matched, each with mean 0 and standard deviation 1; one that does not vary is 0.

    Args:
        values: (N, features).
    """
    return (values - values.mean(0)) / (values.std(0) + _LEAST_SPREAD)
