"""Films of a training: an episode of the policy of the moment, every so many evaluations, in `films/` of its folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from enn.policy import Policy

CHOICE = "ENDONAV_FILMS"  # variable of the environment: of so many evaluations one is filmed; jobs inherit it
FOLDER = "films"


@dataclass
class TrainingFilms:
    """Films the first evaluation and every `every`-th after it; it draws nothing that the training draws.

    Attributes:
        make: an environment of the evaluations, of the film's own.
        seed: of the episode, the same in every film.
    """

    folder: Path
    make: Callable[[], Any]
    seed: int
    every: int
    evaluations: int = 0

    def __call__(self, policy: Policy, decisions: int) -> None:
        """Films an episode of the best actions after so many decisions, if it is time."""
        self.evaluations += 1
        if (self.evaluations - 1) % self.every:
            return
        from cathsim.viewing.film import Film

        environment, film, controller = self.make(), Film(), policy.controller()
        observation, info = environment.reset(seed=self.seed)
        bare = getattr(environment, "current", environment)  # of an environment over many anatomies
        film.add(bare)
        ended = False
        while not ended:
            observation, _, success, truncated, info = environment.step(controller(observation, info))
            film.add(bare)
            ended = success or truncated
        path = self.folder / FOLDER / f"{decisions:08d}.gif"
        with atomic_path(path) as temporary:
            film.write(temporary)
        film.close()
        environment.close()


def training_films(folder: Path, make: Callable[[], Any], seed: int) -> TrainingFilms | None:
    """The films of a training, or None where the run makes none; arguments as of `TrainingFilms`."""
    every = int(os.environ.get(CHOICE) or 0)
    return TrainingFilms(folder, make, seed, every) if every else None
