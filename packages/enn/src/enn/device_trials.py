"""Which devices reach a target: policies that steer different devices play a few episodes in copies of an anatomy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import gymnasium

    from enn.policy import Policy

FIRST, TRIALS = 3, 6  # episodes of the usual devices, which are taken if all of them arrive; else of each policy
HALF = 0.5  # of the copies: devices that reach the target more seldom have little to learn from
CHANCE = 0.25  # of a few episodes by which success may differ and mean nothing
GENTLE = 0.15  # N, 95th percentile: what presses less is not chosen for that
Trial = tuple[bool, list[float]]  # of an episode: whether it arrived, the largest force of each step, N


@dataclass(frozen=True)
class TrialStatistics:
    """Statistics of a policy's trials with its devices.

    Attributes:
        reached: episodes in which the target was reached.
        episodes: all of them.
        steps: mean of all episodes, of those that failed all of theirs.
        force_p95: 95th percentile of the largest resultant force of each step, over all steps, N.
    """

    reached: int
    episodes: int
    steps: float
    force_p95: float

    @property
    def share(self) -> float:
        """Of the episodes, those in which the target was reached."""
        return self.reached / self.episodes

    def __str__(self) -> str:
        return f"{self.reached} of {self.episodes} ({self.force_p95:.2f} N)"

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> TrialStatistics:
        """The statistics of some trials, at least one."""
        forces = np.concatenate([forces for _, forces in trials])
        reached = sum(reached for reached, _ in trials)
        return cls(reached, len(trials), len(forces) / len(trials), float(np.percentile(forces, 95)))


def try_in_copies(
    policy: Policy,
    environment: gymnasium.Env[Any, Any],
    seed: int,
    *,
    cases: Sequence[int],
    tick: Callable[[float], None] = lambda done: None,
) -> list[Trial]:
    """Lets a policy by a roadmap play one episode in each of some copies of an environment, its actions drawn.

    Args:
        environment: with the devices of the policy and its observations; `reset` takes ``options={"case": k}``.
        seed: of the episode in case 0; that in case k has the k-th after it.
        cases: which copies.
        tick: is given the share of the episodes that are done.

    Returns:
        For each episode whether it reached the target, and the largest resultant force of its steps, N.
    """
    trials: list[Trial] = []
    tick(0.0)
    for case in cases:
        trials.append(play_case(policy, environment, seed, case, deterministic=False))
        tick(len(trials) / len(cases))
    return trials


def play_case(
    policy: Policy, environment: gymnasium.Env[Any, Any], seed: int, case: int, *, deterministic: bool
) -> Trial:
    """Plays one episode in a case of an environment; its seed is the sum of both."""
    controller = policy.controller(deterministic=deterministic, seed=seed + case)
    observation, info = environment.reset(seed=seed + case, options={"case": case})
    ended = reached = False
    forces: list[float] = []
    while not ended:
        observation, _, reached, truncated, info = environment.step(controller(observation, info))
        forces.append(float(info["force"]))
        ended = bool(reached or truncated)
    return bool(reached), forces


def best_devices(tries: Sequence[Callable[[int], TrialStatistics]], usual: int) -> int:
    """Number of the devices to take: the usual ones if they arrive in the first copies, else `soonest` of all.

    Args:
        tries: play so many episodes with the devices of one policy, each in a copy of its own.
        usual: number of the devices that are taken without trials.
    """
    if tries[usual](FIRST).reached == FIRST:
        return usual
    return soonest([one(TRIALS) for one in tries], usual)


def soonest(statistics: Sequence[TrialStatistics], usual: int = 0) -> int:
    """Number of the devices that reached the target most often; among equals the usual ones, then the soonest ones."""
    numbers = range(len(statistics))
    return max(numbers, key=lambda number: (statistics[number].share, number == usual, -statistics[number].steps))


def try_until_gentle(
    names: Sequence[str],
    softer: Callable[[], Sequence[str]],
    play: Callable[[Sequence[str], int], Sequence[Sequence[Trial]]],
    limit: float,
) -> dict[str, TrialStatistics]:
    """Tries devices of one anatomy, the first of them alone, others only where it fails or presses too hard.

    Where the `gentlest` of those that arrive press too hard, the gentler ones play in as many further copies: that
    they did not arrive may have been chance.

    Args:
        names: of the devices, the usual ones first.
        softer: names of further ones, called where the usual ones arrive and press too hard.
        play: plays the copies of a turn with some of them: their names and the turn, from 0, to the trials of each.
        limit: 95th percentile of the force from which on devices press too hard, N.

    Returns:
        The statistics of those that played, by name.
    """
    candidates = list(names[:1])
    trials = play(candidates, 0)
    usual = TrialStatistics.of(trials[0])
    pressing = usual.force_p95 > limit
    if usual.reached < usual.episodes or pressing:
        candidates = [*names, *(softer() if usual.reached and pressing else ())]
        trials = [*trials, *play(candidates[1:], 0)]
    statistics = [TrialStatistics.of(one) for one in trials]
    if any(one.reached for one in statistics) and statistics[gentlest(statistics, limit)].force_p95 > limit:
        soft = [n for n, one in enumerate(statistics) if one.share >= HALF - CHANCE and one.force_p95 <= limit]
        further = play([candidates[number] for number in soft], 1) if soft else []
        for number, more in zip(soft, further, strict=True):
            statistics[number] = TrialStatistics.of([*trials[number], *more])
    return dict(zip(candidates, statistics, strict=True))


def gentlest(statistics: Sequence[TrialStatistics], limit: float = math.inf) -> int:
    """Number of the devices that press least among those that reach the target in half of the copies.

    Whoever reaches it in a share of the copies that is lower than the best one's by more than `CHANCE` is left out
    unless the others press too hard. Of those that press with at most `GENTLE` the ones that reach it most often are
    taken. Where none reaches it in half, it is `soonest` of those that do not press too hard and reach it about as
    often as the best ones, or else of all.

    Args:
        limit: 95th percentile of the force from which on they press too hard, N.
    """
    numbers, most = range(len(statistics)), max(one.share for one in statistics)
    often = [number for number in numbers if statistics[number].reached and statistics[number].share >= most - CHANCE]
    half = [number for number in numbers if statistics[number].share >= HALF]
    if not half:
        gentle = [number for number in often if statistics[number].force_p95 <= limit]
        among: Sequence[int] = gentle or numbers
        return among[soonest([statistics[number] for number in among])]

    def rank(number: int) -> tuple[float, float, float]:
        force = statistics[number].force_p95
        return max(force, GENTLE), -statistics[number].share, force

    among = [number for number in often if number in half]
    for group in (among, half):
        gentle = [number for number in group if statistics[number].force_p95 <= limit]
        if gentle:
            return min(gentle, key=rank)
    return min(among, key=rank)
