"""A training that starts from a policy: what has to agree, and how its learner takes the weights over."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from enn.policy import Policy

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from enn.reinforcement.proximal_policy import PpoLearner
    from enn.reinforcement.soft_actor_critic import SacLearner
    from enn.reinforcement.training.settings import TrainingSettings


def start_from(learner: SacLearner | PpoLearner, policy: Policy, settings: TrainingSettings, envs: VecEnv) -> None:
    """Gives a learner the weights of a policy, critics and normalisation included.

    Args:
        settings: of the training; its network must be the policy's: `settings.with_network(policy.network)`.
        envs: of the training, whose observations and actions must be the policy's.

    Raises:
        ValueError: the policy has no critics, an encoder, another network, action repeat, or other observations or
            actions.
    """
    if not policy.critics:
        raise ValueError(
            "the policy to start from has no critics: train it again with keep_critics=True, or start from nothing"
        )
    if policy.encoder is not None or settings.passthrough:
        raise ValueError("a training starts from a policy without an encoder: give one that sees its observations")
    mine, theirs = asdict(settings.network), asdict(policy.network)
    differing = [name for name in mine if mine[name] != theirs[name]]
    if differing:
        told = ", ".join(f"{name}={theirs[name]}, not {mine[name]}" for name in differing)
        raise ValueError(f"the policy to start from is another network ({told}): take settings.with_network(…)")
    if policy.action_repeat != settings.action_repeat:
        raise ValueError(
            f"the policy to start from holds actions for {policy.action_repeat} steps, the training for "
            f"{settings.action_repeat}: give the training the same action_repeat"
        )
    for name, its, ours in (
        ("observations", policy.module.observation_space, envs.observation_space),
        ("actions", policy.action_space, envs.action_space),
    ):
        if its != ours:
            raise ValueError(f"the policy to start from has the {name} {its}, the training's environment {ours}")
    learner.start_from(policy.module.state_dict(), policy.metadata)
