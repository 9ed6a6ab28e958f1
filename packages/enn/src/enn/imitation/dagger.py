"""DAgger: the student steers, the expert says what it would have done there, and all of it is learnt from.

Source: S. Ross, G. Gordon, D. Bagnell, A reduction of imitation learning and structured prediction to no-regret online
learning, AISTATS 2011, algorithm 3.1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import NDArray

from enn.fitting import EpisodeFitProgress, FitReport
from enn.imitation.behaviour_cloning import DESK_CLONING, BehaviourCloningSettings, clone
from enn.imitation.cloned_policy import ClonedPolicy
from enn.policy import Policy
from enn.setting_kinds import Count, Share, settings
from enn.trajectory import Trajectory

TWO_DEVICES = 4  # actions of a wire in a catheter
CORRELATION = 0.8  # of the noise of one action and the next, of `PerturbedController`

Act = Callable[[Mapping[str, NDArray[Any]], Mapping[str, Any]], NDArray[Any]]  # observation, info -> action


@settings
class DaggerSettings:
    """How episodes are aggregated."""

    rounds: Count = 3
    episodes: Count = 10  # a round


@settings
class DisturbanceSettings:
    """How the actions of an actor are disturbed."""

    noise: Annotated[float, Interval(ge=0, le=10)] = 0.3  # standard deviation added to each action
    spell_chance: Share = 0.05  # that a spell of a random action begins at a step
    spell_steps: Count = 8  # longest length of a spell
    # mean of the first action in a spell, and of the third of four; above zero, spells press the tip forwards, into
    # whatever is there
    push: Annotated[float, Interval(ge=-10, le=10)] = 0.2


@dataclass(frozen=True)
class DaggerRound:
    """What a round came to."""

    round: int
    episodes: int  # aggregated so far
    success: float  # share of this round's roll-outs
    disagreement: float  # mean distance of the student's actions from the expert's, in the roll-outs
    fit: FitReport


def record(
    environment: gymnasium.Env[Any, Any],
    steers: Act,
    *,
    seed: int,
    keys: Sequence[str],
    labels: Act | None = None,
    options: dict[str, Any] | None = None,
    start_state: Callable[[], NDArray[Any]] | None = None,
    metadata: dict[str, Any] | None = None,
) -> Trajectory:
    """Runs an episode and keeps what one actor did, or what another would have done.

    Args:
        environment: with dictionary observations that both actors can see, and `tip` and `force` in its info.
        labels: whose actions are kept; None: the steering actor's.
        options: of the reset.
        start_state: gives the moment as a state that an episode can be started from; None: none is kept.
    """
    for actor in (steers, labels):
        if hasattr(actor, "reset"):
            actor.reset()  # type: ignore[union-attr]
    observation, info = environment.reset(seed=seed, options=options)
    seen: dict[str, list[Any]] = {key: [observation[key]] for key in keys}
    tips, actions, rewards, forces = [info["tip"]], [], [], []
    states = [] if start_state is None else [start_state()]
    ended = terminated = False
    while not ended:
        done = np.asarray(steers(observation, info), np.float32)
        actions.append(done if labels is None else np.asarray(labels(observation, info), np.float32))
        observation, reward, terminated, truncated, info = environment.step(done)
        for key in keys:
            seen[key].append(observation[key])
        tips.append(info["tip"])
        rewards.append(reward)
        forces.append(info["force"])
        if start_state is not None:
            states.append(start_state())
        ended = bool(terminated or truncated)
    return Trajectory(
        observations={key: np.stack(values) for key, values in seen.items()},
        actions=np.stack(actions),
        rewards=np.array(rewards, np.float64),
        terminated=bool(terminated),
        forces=np.array(forces, np.float64),
        tips=np.array(tips, np.float64),
        simulation_states=np.stack(states) if states else None,
        metadata={"seed": seed, **(metadata or {})},
    )


class Disturbed:
    """An actor whose actions are disturbed on their way: demonstrations that also show how to recover.

    With some probability a spell of a few steps begins in which a random action is carried out instead; between
    spells Gaussian noise is added.

    Source: M. Laskey et al., DART: Noise injection for robust imitation learning, CoRL 2017, for the idea.
    """

    def __init__(
        self, actor: Act, generator: np.random.Generator, disturbance: DisturbanceSettings | None = None
    ) -> None:
        self.actor, self.generator, self.disturbance = actor, generator, disturbance or DisturbanceSettings()
        self._left, self._spell = 0, np.zeros(0, np.float32)

    def reset(self) -> None:
        """Starts an episode."""
        self._left = 0
        if hasattr(self.actor, "reset"):
            self.actor.reset()

    def __call__(self, observation: Mapping[str, NDArray[Any]], info: Mapping[str, Any]) -> NDArray[np.float32]:
        """The action that is carried out. Shape (actions,)."""
        action, size = np.asarray(self.actor(observation, info), np.float32), self.disturbance
        if self._left == 0 and self.generator.random() < size.spell_chance:
            self._left = int(self.generator.integers(1, size.spell_steps + 1))
            self._spell = self.generator.uniform(-1.0, 1.0, action.shape).astype(np.float32)
            pushed = slice(0, 3, 2) if action.size == TWO_DEVICES else slice(1)  # translations of wire and catheter
            self._spell[pushed] = np.clip(self._spell[pushed] + size.push, -1.0, 1.0)
        if self._left > 0:
            self._left -= 1
            return self._spell
        noisy: NDArray[np.float32] = np.clip(action + self.generator.normal(0.0, size.noise, action.shape), -1.0, 1.0)
        return noisy.astype(np.float32)


def dagger(
    make_environment: Callable[[], gymnasium.Env[Any, Any]],
    expert: Act,
    trajectories: Sequence[Trajectory],
    settings: DaggerSettings | None = None,
    cloning: BehaviourCloningSettings = DESK_CLONING,
    *,
    student: ClonedPolicy | None = None,
    seed: int = 0,
    progress: Callable[[int, EpisodeFitProgress], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[ClonedPolicy, list[DaggerRound], list[Trajectory]]:
    """Improves a student where it goes itself.

    Args:
        make_environment: makes an environment with the observations of both expert and student.
        expert: says what to do at an observation.
        trajectories: the expert's own episodes; may be none.
        student: to start from; None: it is cloned from `trajectories`, of which there must be some then.
        progress: called with the round (0: the first clone) after every epoch.

    Returns:
        The student, what each round came to, and all episodes that it has learnt from.

    Raises:
        ValueError: neither a student nor episodes to clone one from.
    """
    settings = settings or DaggerSettings()
    everything = list(trajectories)

    def refit(index: int, initial: ClonedPolicy | None) -> tuple[ClonedPolicy, FitReport]:
        return clone(
            everything,
            cloning,
            initial=initial,
            seed=seed + index,
            progress=None if progress is None else lambda fit: progress(index, fit),
            device=device,
        )

    if student is None:
        student, _ = refit(0, None)
    environment = make_environment()
    rounds = []
    for index in range(1, settings.rounds + 1):
        generator = np.random.default_rng((seed, index))
        steers = student.controller()
        new, apart = [], []
        for episode in range(settings.episodes):
            start = int(generator.integers(2**31))
            name = f"round {index}, episode {episode}"
            new.append(
                record(environment, steers, seed=start, keys=student.keys, labels=expert, metadata={"file": name})
            )
            done = student.act_batch({key: new[-1].observations[key][:-1] for key in student.keys})
            apart.append(np.linalg.norm(done - new[-1].actions, axis=1))
        everything += new
        student, report = refit(index, student)
        success = float(np.mean([trajectory.terminated for trajectory in new]))
        rounds.append(DaggerRound(index, len(everything), success, float(np.concatenate(apart).mean()), report))
    environment.close()
    return student, rounds, everything


class PerturbedController:
    """A policy over one episode, disturbed by a share of noise that is drawn once, from none to nothing else.

    Args:
        policy: that steers; each action is held for its action repeat.
    """

    def __init__(self, policy: Policy, generator: np.random.Generator) -> None:
        self._policy, self._generator = policy, generator
        self._size = int(np.prod(policy.action_space.shape or ()))
        self._share = generator.uniform()
        self._noise = generator.normal(0.0, 1.0, self._size)
        self._left = 0
        self._action: NDArray[np.float32] = np.zeros(self._size, np.float32)

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The action of this step, in -1 to 1. Shape (actions,)."""
        if self._left == 0:
            fresh = self._generator.normal(0.0, 1.0, self._size)
            self._noise = CORRELATION * self._noise + np.sqrt(1 - CORRELATION**2) * fresh
            advice = self._policy.act_batch({key: observation[key][None] for key in self._policy.keys})[0]
            mixed = (1 - self._share) * advice + self._share * self._noise
            self._action = np.clip(mixed, -1.0, 1.0).astype(np.float32)
            self._left = self._policy.action_repeat
        self._left -= 1
        return self._action
