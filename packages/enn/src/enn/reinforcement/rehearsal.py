"""Rehearsal: a policy is trained in perturbed copies of one anatomy, and put to the test in other copies.

The environment is any whose `reset` takes ``options={"case": k}`` and which tells how many `cases` it has, such as
``gymnasium.make("cathsim:cathsim/NavigateCopies-v0", …)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from enn.device_trials import play_case
from enn.imitation.dagger import Act, record
from enn.policy import Policy
from enn.reinforcement.evaluation import EvaluationResult, LatestPolicy
from enn.reinforcement.resources import Workers
from enn.reinforcement.training.result import Progress, TrainingResult
from enn.reinforcement.training.settings import DESK_SAC, SacSettings, TrainingSettings
from enn.reinforcement.training.training import Training
from enn.trajectory import Trajectory

Environment = gymnasium.Env[Any, Any]
SettingsKind = TypeVar("SettingsKind", bound=TrainingSettings)

# From a policy: learning with the full rate and from a nearly empty replay buffer forgets it within a few hundred
# decisions.
SLOWER, FIRST = 0.2, 0.4  # share of the learning rate; share of the decisions that it only acts
# With demonstrations there is something to learn that it does not do yet, and to learn it from: the same two, and the
# share of each batch that is drawn from demonstrations. Their actions are cloned where the critics prefer them.
DEMONSTRATION_SLOWER, DEMONSTRATION_FIRST, DEMONSTRATION_SHARE = 0.3, 0.05, 0.25
DEMONSTRATION_CLONING = 1.0  # weight of that

# Of a policy by a roadmap in many cases: a wider network than for one anatomy, and fresh starts, which hard cases lack.
# A few cases are soon learnt; the critics are kept, since a rehearsal starts from them.
MANY_CASES = replace(
    DESK_SAC,
    keys=("roadmap", "history"),
    batch_size=256,
    gradient_steps=0.5,
    n_envs=16,
    start_state_buffer_share=0.5,
    start_state_buffer_capacity=64,
    stop_after=2,
    keep_critics=True,
)
# The actor and the critics are as wide as those for many anatomies, whose weights it may start from.
REHEARSAL = replace(
    MANY_CASES,
    hidden=(256, 256),
    overlap=True,
    decisions=20_000,
    buffer_size=20_000,
    demonstrations_in_replay=0.0,
    evaluate_every=7_000,
    evaluation_episodes=16,
    keep_latest=True,
)


@dataclass(frozen=True)
class CaseOutcomes:
    """How a policy did in some cases, an episode each."""

    success: NDArray[np.bool_]  # whether the target was reached. Shape (n,).
    steps: NDArray[np.int64]  # shape (n,)
    forces: NDArray[np.float64]  # contact force of every step of all episodes, N

    @property
    def force_p95(self) -> float:
        """95th percentile of the force over all steps, N."""
        return float(np.percentile(self.forces, 95))


def rehearse(
    make_env: Callable[[], Environment],
    *,
    make_validation_env: Callable[[], Environment] | None = None,
    policy: Policy | None = None,
    settings: TrainingSettings = REHEARSAL,
    starts: Sequence[NDArray[Any]] = (),
    demonstrations: Sequence[Trajectory] = (),
    folder: Path | str | None = None,
    seed: int = 0,
    metadata: dict[str, Any] | None = None,
    first_result: EvaluationResult | None = None,
    after_evaluation: Callable[[Policy, int], None] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> TrainingResult:
    """Trains in the cases of an environment, from a policy or from nothing.

    Args:
        make_env: makes an environment of the training.
        make_validation_env: makes one of the cases that choose the policy, which an evaluation plays in turn; None:
            `make_env`.
        policy: with critics, to start from; its network and action repeat replace those of the settings. It learns at a
            fifth of their rate, and only acts for the first two fifths of the decisions; with demonstrations at three
            tenths, and for the first twentieth.
        settings: of the training; the number of cases is filled in, and with demonstrations their share of each batch,
            where it is 0 and the algorithm keeps a replay buffer.
        starts: states to start from beside the usual start, the case last: an array a case. Shapes (k, n).
        demonstrations: episodes in these cases that reached the target, whoever steered, with the rewards of `make_env`
            (`demonstrated`); their states are starts, too.
        folder: where it can go on after an interruption; None: only in memory.
        first_result: `first_evaluation` of the policy, where it was played already.
        after_evaluation: as of `TrainingInputs`.

    Raises:
        ValueError: the policy has no critics, or sees or does something else than the environment.
    """
    env = make_env()
    cases = cases_of(env)
    env.close()
    changed: TrainingSettings = settings.sized(
        settings.decisions, settings.evaluation_episodes, start_state_buffer_cases=cases
    )
    if demonstrations and isinstance(changed, SacSettings) and not changed.demonstrations_in_replay:
        changed = replace(changed, demonstrations_in_replay=DEMONSTRATION_SHARE, cloning_weight=DEMONSTRATION_CLONING)
    if policy is not None:
        first, slower = (DEMONSTRATION_FIRST, DEMONSTRATION_SLOWER) if demonstrations else (FIRST, SLOWER)
        changed = starting_from(replace(changed, action_repeat=policy.action_repeat), policy, first, slower)
    training = Training(
        changed,
        make_env,
        folder,
        seed=seed,
        metadata=metadata,
        starts=starts,
        demonstrations=demonstrations,
        make_validation_env=partial(_in_turn, make_validation_env or make_env),
        initial=policy,
        initial_result=first_result,
        after_evaluation=after_evaluation,
    )
    return training.run(progress)


def first_evaluation(
    policy: Policy, make_validation_env: Callable[[], Environment], settings: TrainingSettings, *, seed: int = 0
) -> EvaluationResult:
    """Plays the evaluation with which `rehearse` begins, for settings that keep the latest policy.

    Args:
        make_validation_env: as of `rehearse`.
        settings: with the number of its episodes, of the environments beside each other and of the threads.
        seed: of the training.
    """
    episodes = settings.evaluation_episodes
    envs = [_in_turn(make_validation_env) for _ in range(min(episodes, settings.n_envs))]
    workers = Workers(settings.threads)
    try:
        return LatestPolicy(episodes, seed).play(policy, envs, workers=workers, deterministic=False)
    finally:
        workers.close()
        for env in envs:
            env.close()


class _InTurn(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Episodes of successive seeds take place in one case after the other, so that an evaluation leaves none out."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            options = {"case": seed % cases_of(self), **(options or {})}
        return self.env.reset(seed=seed, options=options)


def _in_turn(make_env: Callable[[], Environment]) -> Environment:
    return _InTurn(make_env())


def starting_from(settings: SettingsKind, policy: Policy, first: float = FIRST, slower: float = SLOWER) -> SettingsKind:
    """Settings of a training that starts from a policy: its network, a share of the learning rate.

    Args:
        first: share of the decisions in which the policy only acts.
        slower: share of the learning rate.
    """
    return replace(
        settings.with_network(policy.network),
        learning_rate=slower * settings.learning_rate,
        learning_starts=max(settings.learning_starts, round(first * settings.decisions)),
    )


def demonstrated(controller: Act, env: Environment, case: int, keys: Sequence[str], *, seed: int) -> Trajectory:
    """Plays an episode in a case and keeps what was done in it, for `rehearse`.

    Args:
        controller: of any policy, whatever it observes of the environment.
        env: with the rewards of the training, and `start_state()`.
        keys: what is kept of its observations: those of the training.
        seed: of the episode.
    """
    start_state = env.get_wrapper_attr("start_state")
    return record(env, controller, seed=seed, keys=keys, options={"case": case}, start_state=start_state)


def play_cases(
    policy: Policy,
    env: Environment,
    *,
    deterministic: bool = True,
    seed: int = 0,
    report: Callable[[int, int], None] | None = None,
) -> CaseOutcomes:
    """Plays one episode in every case of an environment.

    Args:
        seed: of the first episode; the k-th has the k-th after it.
        report: takes the episodes played and how many succeeded, after each.

    Raises:
        ValueError: the environment has no cases.
    """
    success, steps, forces = [], [], []
    for case in range(cases_of(env)):
        reached, pressed = play_case(policy, env, seed, case, deterministic=deterministic)
        success.append(reached)
        steps.append(len(pressed))
        forces += pressed
        if report is not None:
            report(case + 1, sum(success))
    return CaseOutcomes(np.array(success), np.array(steps), np.array(forces))


def cases_of(env: Environment) -> int:
    """How many cases an environment has.

    Raises:
        ValueError: it has none.
    """
    cases = getattr(env.unwrapped, "cases", None)
    if not isinstance(cases, int):
        raise ValueError(f"a rehearsal needs an environment with cases, such as cathsim/NavigateCopies-v0, got {env}")
    return cases
