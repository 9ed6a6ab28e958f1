"""Network: how actor and critic are built from settings, and the actor's distribution and features."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy, MultiInputActorCriticPolicy
from stable_baselines3.sac.policies import SACPolicy
from torch import Tensor, nn

from enn.networks.features import VARIANTS, MultimodalExtractor
from enn.networks.normalisation import VectorExtractor
from enn.networks.observation_spaces import select_keys, vector_spaces
from enn.networks.policies import LayerNormSACPolicy
from enn.setting_kinds import Units, settings

ALGORITHMS = ("sac", "ppo")
EXTRACTORS = ("vectors", "multimodal")
ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}


@settings
class NetworkSettings:
    """Everything that shapes of weights depend on, besides the spaces."""

    algorithm: str = "sac"  # "sac" or "ppo"
    keys: tuple[str, ...] = ()  # observations that the actor sees; none: all
    extractor: str = "vectors"  # "vectors" (flat, normalised) or "multimodal" (`enn.networks.features`)
    variant: str = "desk"  # of the multimodal extractor: "thesis", "desk", or "baselines"
    # Features an image of the multimodal extractor: 128 in the thesis's table, 256 in its text.
    image_features: Units = 128
    hidden: tuple[Units, ...] = (128, 128)
    critic_hidden: tuple[Units, ...] | None = None
    activation: str = "relu"  # "relu" or "tanh"
    critic_layer_norm: bool = False  # layer normalisation in the critics; SAC only

    def __post_init__(self) -> None:
        choices = (
            ("algorithm", ALGORITHMS),
            ("extractor", EXTRACTORS),
            ("variant", VARIANTS),
            ("activation", tuple(ACTIVATIONS)),
        )
        for name, known in choices:
            if getattr(self, name) not in known:
                raise ValueError(f"unknown {name} '{getattr(self, name)}'; there are {', '.join(known)}")
        if self.critic_layer_norm and self.algorithm != "sac":
            raise ValueError("only SAC has a critic of its own: leave critic_layer_norm out with ppo")


def network_class(settings: NetworkSettings, space: gymnasium.Space[Any]) -> tuple[type[BasePolicy], dict[str, Any]]:
    """The policy class of stable-baselines3 and its arguments.

    Raises:
        ValueError: an observation is missing in the space, or an image has no extractor for images.
    """
    is_dict = isinstance(space, gymnasium.spaces.Dict)
    critic = settings.hidden if settings.critic_hidden is None else settings.critic_hidden
    value = "qf" if settings.algorithm == "sac" else "vf"
    arguments: dict[str, Any] = {
        "net_arch": {"pi": list(settings.hidden), value: list(critic)},
        "activation_fn": ACTIVATIONS[settings.activation],
        "optimizer_kwargs": {"fused": True},
    }
    keys = select_keys(space, settings.keys) if isinstance(space, gymnasium.spaces.Dict) else ()
    if settings.extractor == "vectors":
        vector_spaces(space, keys)  # refuses images
        extractor: tuple[Any, dict[str, Any]] = (VectorExtractor, {})
    elif is_dict:
        extractor = (MultimodalExtractor, {"variant": settings.variant, "image_features": settings.image_features})
    else:
        raise ValueError("the multimodal extractor needs observations by name: make the environment with several names")
    arguments |= {"features_extractor_class": extractor[0], "features_extractor_kwargs": extractor[1]}
    if settings.algorithm == "sac":
        arguments["critic_layer_norm"] = settings.critic_layer_norm
    arguments["features_extractor_kwargs"] |= {"keys": keys}
    if settings.algorithm == "ppo":
        return (MultiInputActorCriticPolicy if is_dict else ActorCriticPolicy), arguments
    return LayerNormSACPolicy, arguments


def build_network(
    settings: NetworkSettings, space: gymnasium.Space[Any], action_space: gymnasium.spaces.Box
) -> BasePolicy:
    """A network with fresh weights, that acts and is not trained: it has no optimiser."""
    policy, arguments = network_class(settings, space)
    return policy(space, action_space, lambda _: 1e-3, optimizer_class=_NoOptimiser, **arguments)


class _NoOptimiser:
    """The first optimiser of a process imports torch.compile, which takes 2 CPU-s."""

    def __init__(self, parameters: Iterable[Tensor], **settings: object) -> None:
        del parameters, settings


def actor_features(network: Any, observations: dict[str, Tensor] | Tensor) -> Tensor:
    """The features that the actor extracts. Shape (N, features)."""
    if isinstance(network, SACPolicy):
        return network.actor.extract_features(observations, network.actor.features_extractor)
    return network.extract_features(observations, network.pi_features_extractor)


def action_distribution(network: Any, observations: dict[str, Tensor] | Tensor) -> tuple[Tensor, Tensor]:
    """Mean and log of the standard deviation of the actor's Gaussian, before SAC's tanh. Shapes (N, actions)."""
    if isinstance(network, SACPolicy):
        mean, log_std, _ = network.actor.get_action_dist_params(observations)
        return mean, log_std
    mean = network.action_net(network.mlp_extractor.forward_actor(actor_features(network, observations)))
    return mean, network.log_std.expand_as(mean)
