"""Rules of a rehearsal: who demonstrates, when part of a training is enough, and when one goes on from another.

They go by how often policies arrive. What they rest on is measured in `docs/results/rehearsal.md`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from enn.device_trials import TrialStatistics
from enn.reinforcement.rehearsal import REHEARSAL
from enn.reinforcement.training.result import TrainingResult
from enn.reinforcement.training.settings import DESK_PPO, TrainingSettings

NEEDED, ALWAYS, NEVER = "needed", "always", "never"  # turns of the sampling expert
# Without demonstrations, whose actions would be cloned, it has to explore.
REHEARSAL_PPO = replace(
    DESK_PPO,
    keys=REHEARSAL.keys,
    learning_rate=3e-4,
    log_std_init=0.0,
    log_std_final=None,
    reward_scale=1.0,
    ent_coef=0.003,
    cloning_weight=0.0,
    keep_latest=True,
)

Who = TypeVar("Who")


@dataclass(frozen=True)
class Turn(Generic[Who]):
    """An episode in every copy of the training, all by one policy.

    Attributes:
        policy: that plays; None: the sampling expert.
        number: of the turns of that policy, from 0.
    """

    policy: Who | None
    number: int = 0


@dataclass(frozen=True)
class RehearsalRules:
    """What a rehearsal does by how often policies arrive; shares are of episodes.

    Attributes:
        demonstrations: that arrive are enough.
        expert: turns of the sampling expert: "needed" where policies give too few, "always" first, "never".
        often: share from which on the policy that it starts from learns from its own demonstrations.
        rounds: turns of one policy at most.
        few: one in so many of the demonstrations: where policies give fewer, the expert demonstrates.
        mostly: share of the first demonstrations from which on a part of the training may be enough.
        surely: share of these, of the trials of devices and of episodes elsewhere together, for the same.
        seldom: share of a training's latest episodes below which it goes on with another.
        evaluations: in a training, beside that of the policy that it starts from.
        fewer_evaluations: where that policy always arrives.
    """

    demonstrations: int = 12
    expert: str = NEEDED
    often: float = 0.5
    rounds: int = 4
    few: int = 3
    mostly: float = 0.75
    surely: float = 0.8
    seldom: float = 0.9
    evaluations: int = 3
    fewer_evaluations: int = 2

    def turns(
        self, policies: Sequence[Who], start: Who | None, trial_statistics: TrialStatistics | None = None
    ) -> Generator[Turn[Who], Sequence[bool], None]:
        """Turns one after the other; the caller sends where the episodes of the last one arrived.

        The policy to start from is first. Where it seldom arrives it has nothing to learn from, and every other one
        has a turn, then the best of them again. The sampling expert's turn is the last, or with "always" the first.

        Args:
            policies: that steer the devices; the first is `start`, where there is one.
            trial_statistics: statistics of the trials of `start` with its devices.
        """
        arrival_count = 0
        if self.expert == ALWAYS:
            arrival_count += sum((yield Turn(None)))
        arrivals: dict[Who, int] = {}
        best: Who | None = None
        for policy in policies:
            if arrival_count >= self.demonstrations:
                return
            outcomes = yield Turn(policy)
            arrivals[policy] = sum(outcomes)
            arrival_count += arrivals[policy]
            if policy == start and in_share(outcomes, trial_statistics, self.often):
                break
        else:
            # others first: what the start shows it can do already
            best = max(arrivals, key=lambda one: (arrivals[one] > 0 and one != start, arrivals[one]), default=None)
        for number in range(1, self.rounds):
            if best is None or not arrivals[best] or arrival_count >= self.demonstrations:
                break
            arrivals[best] = sum((yield Turn(best, number)))  # a turn in which nobody arrives is the last one
            arrival_count += arrivals[best]
        if self.expert == NEEDED and arrival_count * self.few < self.demonstrations:
            yield Turn(None)

    def mostly_arrives(
        self,
        outcomes: Sequence[bool],
        trial_statistics: TrialStatistics | None,
        elsewhere: Callable[[], Sequence[bool]],
    ) -> bool:
        """Whether the policy to start from mostly arrives, but not always, so that part of a training is enough.

        Where it always arrives it has little to learn, and faster learning has unlearnt some of it. The first episodes
        alone can be lucky: a policy that arrived in 15 of its 17 did in 3 of 8 trials, and in 14 of 30 test copies.

        Args:
            outcomes: of its first demonstrations; empty: it played none.
            elsewhere: plays it in copies that the training does not have; called where `outcomes` say that it does.
        """
        if not outcomes or not self.mostly * len(outcomes) <= sum(outcomes) < len(outcomes):
            return False
        return in_share([*outcomes, *elsewhere()], trial_statistics, self.surely)

    def sometimes_arrives(self, result: TrainingResult) -> bool:
        """Whether a trained policy arrives, but not mostly, so that another training is worth its time.

        It goes by the training's latest episodes from the usual start: they are more than those of an evaluation.
        """
        shares = [row["success"] for row in result.curve if row["success"] is not None]
        return bool(shares) and 0 < shares[-1] < self.seldom

    def training(
        self, algorithm: str, decisions: int, *, share: float = 1.0, evaluations: int | None = None
    ) -> TrainingSettings:
        """Settings of a training with so many decisions, evaluated at equal distances.

        Args:
            algorithm: "sac" or "ppo".
            share: of the decisions, which SAC makes at a rate that is higher by as much; PPO makes all of them.
            evaluations: after which it ends; None: all.
        """
        share = share if algorithm == "sac" else 1.0
        every = math.ceil(share * decisions / self.evaluations)
        decisions = min((evaluations or self.evaluations) * every, math.ceil(share * decisions))
        if algorithm != "sac":
            return replace(REHEARSAL_PPO, decisions=decisions, evaluate_every=every)
        rate = REHEARSAL.learning_rate / share
        return replace(
            REHEARSAL, learning_rate=rate, buffer_size=max(decisions, 1000), decisions=decisions, evaluate_every=every
        )


def in_share(outcomes: Sequence[bool], trial_statistics: TrialStatistics | None, share: float) -> bool:
    """Whether a policy arrives in a share of some episodes, at least one, and of the trials of its devices together."""
    reached, episodes = (0, 0) if trial_statistics is None else (trial_statistics.reached, trial_statistics.episodes)
    return bool(outcomes) and sum(outcomes) + reached >= share * (len(outcomes) + episodes)
