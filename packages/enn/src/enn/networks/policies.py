"""Policies of SAC: actor and critic that look at different observations, and critics that normalise their layers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.sac.policies import Actor, SACPolicy
from torch import nn

from enn.networks.features import MultimodalExtractor, require_keys

TRAINED_BY = ("actor", "critic")  # whose loss trains shared features


class KeyedActor(Actor):
    """SAC's actor that looks at the keys of its own space only; with `detached`, its loss leaves the features alone."""

    observation_space: gymnasium.spaces.Dict
    detached = False

    def extract_features(self, obs: Any, features_extractor: BaseFeaturesExtractor) -> torch.Tensor:
        """Features of the keys that it sees. Shape (n, features_dim)."""
        seen = {key: obs[key] for key in self.observation_space.spaces}
        if not self.detached:
            return super().extract_features(seen, features_extractor)
        with torch.no_grad():
            return super().extract_features(seen, features_extractor)


class KeyedCritic(ContinuousCritic):
    """SAC's twin critics that look at the keys of their own space only."""

    observation_space: gymnasium.spaces.Dict

    def extract_features(self, obs: Any, features_extractor: BaseFeaturesExtractor) -> torch.Tensor:
        """Features of the keys that they see. Shape (n, features_dim)."""
        seen = {key: obs[key] for key in self.observation_space.spaces}
        return super().extract_features(seen, features_extractor)


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
        return self._normalised(super().make_critic(features_extractor))

    def _normalised(self, critic: ContinuousCritic) -> ContinuousCritic:
        if self.critic_layer_norm:
            normalise_layers(critic)
        return critic.to(self.device)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "critic_layer_norm": self.critic_layer_norm}


class AsymmetricSACPolicy(LayerNormSACPolicy):
    """SAC whose critic looks at other observations than its actor, such as the state while the actor has images.

    Only the actor's keys are needed to act. For `stable_baselines3.SAC(AsymmetricSACPolicy, env, policy_kwargs=...)`.

    Args:
        observation_space: a Dict with the keys of both.
        lr_schedule: learning rate by remaining progress.
        actor_keys: that the actor sees; all when None.
        critic_keys: that the critic sees; the actor's when None.
        features_trained_by: with `share_features_extractor`, whose loss trains the shared features: "actor" as in
            stable-baselines3, or "critic", which is the stronger signal for images.
        features_extractor_class: called with a space and `keys`.
        features_extractor_kwargs: its other arguments, for both.
        arguments: of `LayerNormSACPolicy`.

    Raises:
        ValueError: a key that the observation has not, or shared features for different keys.
    """

    observation_space: gymnasium.spaces.Dict

    def __init__(
        self,
        observation_space: gymnasium.spaces.Space[Any],
        action_space: gymnasium.spaces.Box,
        lr_schedule: Schedule,
        *,
        actor_keys: Sequence[str] | None = None,
        critic_keys: Sequence[str] | None = None,
        features_trained_by: str = "actor",
        features_extractor_class: type[BaseFeaturesExtractor] = MultimodalExtractor,
        features_extractor_kwargs: dict[str, Any] | None = None,
        **arguments: Any,
    ) -> None:
        if actor_keys is None:
            actor_keys = tuple(observation_space.spaces) if isinstance(observation_space, gymnasium.spaces.Dict) else ()
        actor_keys = tuple(actor_keys)
        critic_keys = actor_keys if critic_keys is None else tuple(critic_keys)
        require_keys(observation_space, actor_keys)
        require_keys(observation_space, critic_keys)
        if features_trained_by not in TRAINED_BY:
            raise ValueError(f"unknown features_trained_by '{features_trained_by}'; there are {', '.join(TRAINED_BY)}")
        if arguments.get("share_features_extractor") and actor_keys != critic_keys:
            raise ValueError(
                f"the actor looks at {', '.join(actor_keys)} and the critic at {', '.join(critic_keys)}: "
                "features can be shared only between equal keys"
            )
        self.actor_keys, self.critic_keys = actor_keys, critic_keys
        self.features_trained_by = features_trained_by
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            features_extractor_class=features_extractor_class,
            features_extractor_kwargs=features_extractor_kwargs,
            **arguments,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        if not (self.share_features_extractor and self.features_trained_by == "critic"):
            return
        # the same module for both, but in the critic's optimiser instead of the actor's
        actor: Any = self.actor
        actor.detached = True
        critic: Any = self.critic
        critic.share_features_extractor = False  # or it would extract without gradient
        own = [value for name, value in self.actor.named_parameters() if "features_extractor" not in name]
        rate = lr_schedule(1)
        self.actor.optimizer = self.optimizer_class(own, lr=rate, **self.optimizer_kwargs)  # type: ignore[call-arg]
        self.critic.optimizer = self.optimizer_class(
            self.critic.parameters(),
            lr=rate,  # type: ignore[call-arg]
            **self.optimizer_kwargs,
        )

    def _arguments(self, keys: Sequence[str], common: dict[str, Any], extractor: Any) -> dict[str, Any]:
        space = gymnasium.spaces.Dict({key: self.observation_space[key] for key in keys})
        if extractor is None:
            make: Any = self.features_extractor_class
            extractor = make(space, keys=keys, **self.features_extractor_kwargs)
        return {
            **common,
            "observation_space": space,
            "features_extractor": extractor,
            "features_dim": extractor.features_dim,
        }

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """The actor, over its keys."""
        return KeyedActor(**self._arguments(self.actor_keys, self.actor_kwargs, features_extractor)).to(self.device)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContinuousCritic:
        """The twin critics, over their keys."""
        critic = KeyedCritic(**self._arguments(self.critic_keys, self.critic_kwargs, features_extractor))
        return self._normalised(critic)

    def obs_to_tensor(self, observation: np.ndarray | dict[str, np.ndarray]) -> tuple[Any, bool]:
        """The actor's part of an observation as tensors, and whether it is a batch.

        Raises:
            ValueError: a key of the actor's is missing.
        """
        if not isinstance(observation, dict) or any(key not in observation for key in self.actor_keys):
            got = ", ".join(observation) if isinstance(observation, dict) else type(observation).__name__
            raise ValueError(f"the actor needs the observations {', '.join(self.actor_keys)}, got {got}")
        return self.actor.obs_to_tensor({key: observation[key] for key in self.actor_keys})

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            **super()._get_constructor_parameters(),
            "actor_keys": self.actor_keys,
            "critic_keys": self.critic_keys,
            "features_trained_by": self.features_trained_by,
            "share_features_extractor": self.share_features_extractor,
        }
