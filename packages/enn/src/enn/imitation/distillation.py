"""Distillation: an expert policy to a student that sees images alone, by cloning, disturbed episodes and DAgger."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from enn.fitting import EpisodeFitProgress, FitReport
from enn.imitation.behaviour_cloning import BehaviourCloningSettings, clone, samples_digest
from enn.imitation.cloned_policy import ClonedPolicy
from enn.imitation.dagger import Act, DaggerRound, DaggerSettings, Disturbed, dagger, record
from enn.policy import Policy
from enn.trajectory import Trajectory

DISTURBED_SEEDS = range(60)  # starts of episodes with disturbed actions, without which a student cannot recover

MakeEnvironment = Callable[[Sequence[str]], gymnasium.Env[Any, Any]]  # names of observations -> environment


@dataclass(frozen=True)
class Distilled:
    """A student and what it learnt from."""

    student: ClonedPolicy
    fit: FitReport
    episodes: int  # all that it learnt from
    samples: int
    rounds: tuple[DaggerRound, ...] = ()  # of DAgger


def distil(
    expert: Policy,
    episodes: Sequence[Trajectory],
    settings: BehaviourCloningSettings,
    make_environment: MakeEnvironment,
    *,
    disturbed_seeds: Sequence[int] = DISTURBED_SEEDS,
    rounds: DaggerSettings | None = None,
    seed: int = 0,
    folder: Path | str | None = None,
    progress: Callable[[float, str], None] | None = None,
    device: torch.device | str = "cpu",
) -> Distilled:
    """Fits a student to an expert's episodes and to further ones in which the expert's actions were disturbed.

    The expert's features are matched where the settings say so and every episode has the observations for them.

    Args:
        make_environment: makes an environment for disturbed episodes and DAgger.
        disturbed_seeds: starts of the episodes with disturbed actions, one each; (): the expert's episodes alone.
        rounds: of DAgger; None: none.
        progress: called after every epoch with the share done, 0 to 1, and a few words.

    Raises:
        ValueError: no episodes, or episodes of different kinds.
        FitError: a checkpoint of something else.
    """
    keys = tuple(dict.fromkeys((*settings.network.keys, *expert.keys)))
    actor: Act = lambda observation, info: expert.act(observation)  # noqa: E731
    samples = samples_digest(episodes, settings, list(disturbed_seeds))
    episodes = [*episodes, *_disturbed(actor, make_environment, keys, disturbed_seeds, seed)]
    features = None
    if settings.feature_matching and all(set(expert.keys) <= set(one.observations) for one in episodes):
        features = [expert.features({key: one.observations[key] for key in expert.keys}) for one in episodes]
    parts = 1 if rounds is None else rounds.rounds + 1

    def tell(index: int, fit: EpisodeFitProgress) -> None:
        name = f"DAgger round {index}, epoch {fit.epoch}" if index else f"epoch {fit.epoch}, loss {fit.loss:.3f}"
        if progress is not None:
            progress((index + fit.epoch / fit.epochs) / parts, name)

    student, report = clone(
        episodes,
        settings,
        expert_features=features,
        seed=seed,
        samples=samples,
        folder=folder,
        progress=lambda fit: tell(0, fit),
        device=device,
    )
    if rounds is None:
        return Distilled(student, report, len(episodes), sum(map(len, episodes)))
    student, done, everything = dagger(
        lambda: make_environment(keys),
        actor,
        episodes,
        rounds,
        settings,
        student=student,
        seed=seed,
        progress=tell,
        device=device,
    )
    return Distilled(student, done[-1].fit, len(everything), sum(map(len, everything)), tuple(done))


def _disturbed(
    actor: Act, make_environment: MakeEnvironment, keys: Sequence[str], seeds: Sequence[int], seed: int
) -> list[Trajectory]:
    """Episodes with disturbed actions; their labels are the actions that the actor wanted."""
    if not seeds:
        return []
    environment = make_environment(keys)
    episodes = [
        record(
            environment,
            Disturbed(actor, np.random.default_rng((seed, index))),
            seed=start,
            keys=keys,
            labels=actor,
            metadata={"file": f"disturbed episode {index}"},
        )
        for index, start in enumerate(seeds)
    ]
    environment.close()
    return episodes
