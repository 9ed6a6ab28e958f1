"""Task of the navigation: anatomies, rules of an episode, and sets of trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from pipeline.stages.learning.task import REWARD_OF_EVALUATION
from pipeline.stages.navigation.scene import Rig, Scene, scene_environment
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

RESOLUTION = 1e-3  # m, of the anatomies' grids

Anatomy = tuple[str, int]  # kind and seed; a seed below 0: the kind is a phantom's name


@dataclass(frozen=True)
class Rules:
    """A task under the navigation's cameras.

    Attributes:
        task: wire, limits and start; its images are those of a teacher, the navigator's are the rig's.
    """

    task: Task = field(default_factory=Task)

    def rig(self, rig: Rig) -> Rig:
        """The cameras, with the task's wire to be drawn."""
        return replace(rig, wire=self.task.wire)

    def scene(self, anatomy: Anatomy, target: str, rig: Rig, observation: Sequence[str]) -> Scene:
        """An environment under the rig's cameras.

        Args:
            anatomy: kind and seed.
            target: of the episodes.
            rig: of the images; the wire that they show is the task's.
            observation: of a teacher.
        """
        seen = self.rig(rig)
        environment = scene_environment(
            phantom_of(anatomy), target, seen, observation, reward=REWARD_OF_EVALUATION, **self.task.arguments()
        )
        return Scene(environment, seen)


@dataclass(frozen=True)
class TrialSet:
    """Trials on held-out starts.

    Attributes:
        name: in the tables.
        anatomies: one after the other.
        trials: in each, for each target.
        rules: of the trials.
    """

    name: str
    anatomies: tuple[Anatomy, ...]
    trials: int
    rules: Rules


def phantom_of(anatomy: Anatomy) -> Phantom:
    """The phantom of a kind and seed, kept while this process works on it."""
    from cathsim.many_anatomies import SHELF

    kind, seed = anatomy
    return SHELF.take(kind if seed < 0 else (kind, seed), RESOLUTION)


def scenes_of(
    rules: Rules, cases: Sequence[tuple[Anatomy, str]], rig: Rig, keys: Sequence[str], seeds: Sequence[int]
) -> Iterator[tuple[Scene, int]]:
    """Scenes for lessons with the seed of each, made one by one.

    Args:
        rules: of the episodes.
        cases: anatomy and target of each.
        rig: of the images.
        keys: observations that the teacher sees.
        seeds: of the resets.
    """
    for (anatomy, target), seed in zip(cases, seeds, strict=True):
        yield rules.scene(anatomy, target, rig, keys), seed


def room_for(anatomies: Sequence[Anatomy]) -> None:
    """Lets this process keep so many anatomies, since all take turns."""
    from cathsim.many_anatomies import SHELF

    SHELF.capacity = max(SHELF.capacity, len(set(anatomies)))
