"""The task that learning stages train and evaluate on, and the environments made from it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cathsim import NavigateEnv

REWARD_OF_TRAINING, REWARD_OF_EVALUATION = "geodesic", "distance"  # the latter is the thesis's


@dataclass(frozen=True)
class LearningTask:
    """Anatomy, target, wire and rules of an episode.

    Attributes:
        phantom: name of an anatomy.
        target: name of one of its targets.
        wire: name of a guidewire.
        actions: "feeder" (two) or "tip_motors" (twenty-one).
        image_size: side of the images, px.
        max_steps: an episode is cut off after so many.
        success_radius: m.
        accuracy: preset of the simulator.
        start_jitter: the wire starts advanced by up to this much, m.
        start_rotation: ... and turned by up to this much either way, rad.
        reward: of training: "geodesic", shaped, or "distance", the thesis's.
        force_penalty: of the training's reward, a newton.
        path_penalty: of the training's reward, a metre of the tip's way: what makes ways short.
    """

    phantom: str
    target: str
    wire: str = "default"
    actions: str = "feeder"
    image_size: int = 80
    max_steps: int = 300
    success_radius: float = 0.008
    accuracy: str = "accurate"
    start_jitter: float = 0.001
    start_rotation: float = math.pi
    reward: str = REWARD_OF_TRAINING
    force_penalty: float = 0.0
    path_penalty: float = 0.0

    @property
    def name(self) -> str:
        """Phantom and target, which name the folder: ``type_1/bca``."""
        return f"{self.phantom}/{self.target}"

    def environment(self, observation: str | Sequence[str], *, training: bool = False) -> NavigateEnv:
        """Makes an environment.

        Args:
            observation: a name, which gives one array, or several, which give a dictionary.
            training: with the shaped reward and the force's penalty; otherwise with the thesis's reward, which
                is what tables report.
        """
        from cathsim import NavigateEnv

        return NavigateEnv(
            self.phantom,
            self.target,
            wire=self.wire,
            accuracy=self.accuracy,
            actions=self.actions,
            observation=observation if isinstance(observation, str) else tuple(observation),
            image_size=self.image_size,
            max_steps=self.max_steps,
            success_radius=self.success_radius,
            start_jitter=self.start_jitter,
            start_rotation=self.start_rotation,
            reward=self.reward if training else REWARD_OF_EVALUATION,
            force_penalty=self.force_penalty if training else 0.0,
            path_penalty=self.path_penalty if training else 0.0,
        )

    def factory(self, observation: str | Sequence[str]) -> Callable[[], NavigateEnv]:
        """Makes training environments.

        Args:
            observation: as `environment` takes it.
        """
        return functools.partial(self.environment, observation, training=True)
