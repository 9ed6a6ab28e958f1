"""What a training starts from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
from numpy.typing import NDArray

from enn.policy import Policy
from enn.reinforcement.evaluation import EvaluationResult
from enn.reinforcement.start_state_buffer import CaseStartStateBuffer, StartStateBuffer, fill_start_state_buffer
from enn.reinforcement.training.settings import SacSettings, TrainingSettings
from enn.reinforcement.vector_envs import POSSIBLE, SampledEnvs, SubprocessEnvs
from enn.trajectory import Trajectory

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from enn.reinforcement.proximal_policy import PpoLearner
    from enn.reinforcement.soft_actor_critic import SacLearner


WORTH_A_PROCESS = 2_000  # decisions: in fewer it saves less than the three seconds that it takes to start


@dataclass
class TrainingInputs:
    """What a training starts from.

    Attributes:
        make_env: makes one environment; called for each of those sampled, and for evaluation.
        folder: where it is kept; None: only in memory.
        demonstrations: their states enter the start-state buffer; their steps take part in updates, if set so.
        encoder: frozen, turns observations into features.
        metadata: kept in the policy's file, with the seed.
        starts: further states of the start-state buffer, an array for each case or way. Shapes (k, n).
        make_validation_env: makes the environments of the evaluations that choose the best policy; None: `make_env`.
        initial: a policy with critics to start from instead of fresh weights: it acts from the first decision on, is
            evaluated before the first update, and its normalisation stays. Learning begins after `learning_starts`.
        initial_result: of that evaluation, where it was played already and the latest policy is kept.
        after_evaluation: called with the policy and the decisions so far, to film an episode, say; it must not change
            the policy, nor draw from torch's or numpy's generators of the process.
    """

    settings: TrainingSettings
    make_env: Callable[[], gymnasium.Env[Any, Any]]
    folder: Path | str | None = None
    seed: int = 0
    demonstrations: Sequence[Trajectory] = ()
    encoder: Any = None
    metadata: dict[str, Any] | None = None
    starts: Sequence[NDArray[Any]] = ()
    make_validation_env: Callable[[], gymnasium.Env[Any, Any]] | None = None
    initial: Policy | None = None
    initial_result: EvaluationResult | None = None
    after_evaluation: Callable[[Policy, int], None] | None = None

    def make_start_state_buffer(self, settings: TrainingSettings) -> StartStateBuffer | None:
        """A start-state buffer of the demonstrations and starts, or None where no episode is to start from one."""
        arguments = settings.start_state_buffer_share, settings.start_state_buffer_capacity, self.seed
        if settings.start_state_buffer_cases:
            start_state_buffer: StartStateBuffer = CaseStartStateBuffer(settings.start_state_buffer_cases, *arguments)
        elif settings.start_state_buffer_share > 0:
            start_state_buffer = StartStateBuffer(*arguments)
        else:
            return None
        fill_start_state_buffer(start_state_buffer, self.demonstrations)
        for states in self.starts:
            start_state_buffer.add_episode(states)
        return start_state_buffer

    def make_envs(
        self, settings: TrainingSettings, start_state_buffer: StartStateBuffer | None
    ) -> SampledEnvs | SubprocessEnvs:
        """The environments that are sampled; they observe what the networks read, or all that an encoder may.

        Where updates are made meanwhile, by another thread, they get a process of their own, if it is worth its start.
        """
        common: dict[str, Any] = {
            "factories": [self.make_env] * settings.n_envs,
            "seed": self.seed,
            "action_repeat": settings.action_repeat,
            "start_state_buffer": start_state_buffer,
            "keys": settings.keys if self.encoder is None else (),
        }
        threads = min(settings.threads, settings.n_envs)
        overlap = isinstance(settings, SacSettings) and settings.overlap
        if overlap and threads > 1 and settings.decisions >= WORTH_A_PROCESS and POSSIBLE:
            return SubprocessEnvs(**common, threads=threads - 1, evaluation_threads=threads)
        return SampledEnvs(**common, threads=threads)


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
    if policy.encoder is not None:
        raise ValueError("a training starts from a policy without an encoder: give one that sees its observations")
    mine, theirs = asdict(settings.network), asdict(policy.network)
    differing = [name for name in mine if mine[name] != theirs[name]]
    if differing:
        differences = ", ".join(f"{name}={theirs[name]}, not {mine[name]}" for name in differing)
        raise ValueError(f"the policy to start from is another network ({differences}): take settings.with_network(…)")
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
