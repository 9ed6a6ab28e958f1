"""Policies of SAC whose critics may normalise their layers."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import SACPolicy
from torch import nn


def normalise_layers(critic: ContinuousCritic) -> None:
    """Puts a layer normalisation behind every hidden linear layer of twin critics.

    With demonstrations among its data a critic otherwise overestimates actions that they do not show.

    Source: Ball et al. 2023, "Efficient online reinforcement learning with offline data".
    """
    for index, network in enumerate(critic.q_networks):
        layers: list[nn.Module] = []
        *hidden, output = network.children()
        for layer in hidden:
            layers.append(layer)
            if isinstance(layer, nn.Linear):
                layers.append(nn.LayerNorm(layer.out_features))
        critic.q_networks[index] = nn.Sequential(*layers, output)
        setattr(critic, f"qf{index}", critic.q_networks[index])


class LayerNormSACPolicy(SACPolicy):
    """SAC's policy whose critics may normalise their layers.

    Args:
        arguments: of stable-baselines3's `SACPolicy`.
    """

    def __init__(self, *arguments: Any, critic_layer_norm: bool = False, **named: Any) -> None:
        self.critic_layer_norm = critic_layer_norm
        super().__init__(*arguments, **named)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContinuousCritic:
        """The twin critics."""
        critic = super().make_critic(features_extractor)
        if self.critic_layer_norm:
            normalise_layers(critic)
        return critic.to(self.device)
