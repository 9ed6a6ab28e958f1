"""Task of the navigation: anatomies, rules of an episode, and sets of trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.learning_task import REWARD_OF_EVALUATION
from pipeline.navigation_scene import Rig, Scene, scene_environment

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.anatomy import Phantom

RESOLUTION = 1e-3  # m, of the anatomies' grids

Anatomy = tuple[str, int]  # kind and seed; a seed below 0: the kind is a phantom's name


@dataclass(frozen=True)
class Rules:
    """Rules of an episode.

    Attributes:
        wire: preset.
        wire_length: m, to which the wire is scaled; 0: as it is.
        max_steps: an episode is cut off after so many.
        success_radius: m.
        start_jitter: the wire starts advanced by up to this much, m.
        start_rotation: ... and turned by up to this much either way, rad.
    """

    wire: str = "default"
    wire_length: float = 0.0
    max_steps: int = 300
    success_radius: float = 0.008
    start_jitter: float = 0.001
    start_rotation: float = float(np.pi)

    def environment(self, anatomy: Anatomy, target: str, rig: Rig, observation: Sequence[str]) -> NavigateEnv:
        """An environment under the rig's cameras."""
        from cathsim import load_guidewire

        wire = load_guidewire(self.wire)
        return scene_environment(
            phantom_of(anatomy), target, rig, observation,
            wire=wire.scaled(self.wire_length) if self.wire_length else wire,
            max_steps=self.max_steps, success_radius=self.success_radius,
            start_jitter=self.start_jitter, start_rotation=self.start_rotation,
            reward=REWARD_OF_EVALUATION,
        )  # fmt: skip


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
    from cathsim.variety import SHELF

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
        yield Scene(rules.environment(anatomy, target, rig, keys), rig), seed


def room_for(anatomies: Sequence[Anatomy]) -> None:
    """Lets this process keep so many anatomies, since all take turns."""
    from cathsim.variety import SHELF

    SHELF.capacity = max(SHELF.capacity, len(set(anatomies)))
