"""A task with its anatomy and target, as learning stages train and evaluate on it, and its environments."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim import NavigateEnv, Phantom

REWARD_OF_TRAINING, REWARD_OF_EVALUATION = "geodesic", "distance"  # the latter is the thesis's
ACCURACY_OF_TESTS = "accurate"


@dataclass(frozen=True)
class LearningTask:
    """A task in an anatomy, with what only its training knows."""

    phantom: str
    target: str
    task: Task = field(default_factory=Task)  # wire, actions, images, limits and start
    file: AnatomyFile | None = None  # of the anatomy, where it is none of the library
    accuracy: str = ACCURACY_OF_TESTS  # preset of the simulator in training; tests always have the accurate one
    reward: str = REWARD_OF_TRAINING  # of training: "geodesic", shaped, or "distance", the thesis's
    force_penalty: float = 0.0  # of the training's reward, a newton
    path_penalty: float = 0.0  # of the training's reward, a metre of the tip's way: what makes ways short

    @property
    def name(self) -> str:
        """Phantom and target, which name the folder: ``type_1/bca``."""
        return f"{self.phantom}/{self.target}"

    def load_phantom(self) -> Phantom:
        """The anatomy, from the cache where it was built before."""
        return load_anatomy(self.phantom if self.file is None else self.file)

    def environment(
        self, observation: str | Sequence[str], *, training: bool = False, observe_every: int = 1
    ) -> NavigateEnv:
        """Makes an environment.

        Args:
            observation: a name, which gives one array, or several, which give a dictionary.
            training: with the shaped reward, the force's penalty and the training's accuracy; otherwise with the
                thesis's reward and accurate physics, which is what tables report.
            observe_every: steps between two observations that somebody looks at.
        """
        from cathsim import NavigateEnv

        return NavigateEnv(
            self.phantom if self.file is None else self.load_phantom(),
            self.target,
            accuracy=self.accuracy if training else ACCURACY_OF_TESTS,
            observation=observation if isinstance(observation, str) else tuple(observation),
            reward=self.reward if training else REWARD_OF_EVALUATION,
            force_penalty=self.force_penalty if training else 0.0,
            path_penalty=self.path_penalty if training else 0.0,
            observe_every=observe_every,
            **self.task.arguments(self.phantom if self.file is None else None),
        )

    def factory(self, observation: str | Sequence[str], observe_every: int = 1) -> Callable[[], NavigateEnv]:
        """Makes training environments; takes what `environment` does."""
        return functools.partial(self.environment, observation, training=True, observe_every=observe_every)
