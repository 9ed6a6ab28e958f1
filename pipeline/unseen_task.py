"""Task of the stage `unseen`: rules of an episode whatever the anatomy, and the environments that follow them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.learning_task import REWARD_OF_EVALUATION, REWARD_OF_TRAINING

if TYPE_CHECKING:
    from cathsim import Guidewire, NavigateEnv
    from cathsim.variety import NavigateManyEnv

TEST_PHANTOM, WIDE_PHANTOM = "random", "random_wide"
ROADMAP_KEYS = ("roadmap", "history")  # what a policy with a roadmap sees
RESOLUTION = 1e-3  # m: at 1.5 mm thin walls open, and ways become short cuts


def training_arch(seed: int) -> tuple[str, int]:
    """The training anatomy of a seed: by turns one like those of the tests, and one of rare shapes as often as not."""
    return (WIDE_PHANTOM if seed % 2 else TEST_PHANTOM), seed


@dataclass(frozen=True)
class UnseenTask:
    """Targets, wire and rules of an episode, whatever the anatomy.

    Attributes:
        targets: names, each as likely in training.
        wire_length: m; the wires of the tests have it too.
        image_size: side of the images, px.
        max_steps: an episode is cut off after so many.
        success_radius: m.
        start_jitter: the wire starts advanced by up to this much, m.
        start_rotation: ... and turned by up to this much either way, rad.
        accuracy: of the training's physics; tests always have the accurate one.
    """

    targets: tuple[str, ...]
    wire_length: float
    image_size: int = 192
    max_steps: int = 300
    success_radius: float = 0.008
    start_jitter: float = 0.001
    start_rotation: float = np.pi
    accuracy: str = "fast"

    def wire(self, kind: str) -> Guidewire:
        """A wire of the tests: a preset's name, or "softer" and "stiffer", half and twice as stiff as the default."""
        from cathsim import load_guidewire

        factor = {"softer": 0.5, "stiffer": 2.0}.get(kind)
        if factor is None:
            return load_guidewire(kind).scaled(self.wire_length)
        wire = load_guidewire("default").scaled(self.wire_length)
        return load_guidewire(
            "default",
            links=wire.links,
            shaft_stiffness_nmm2=factor * wire.shaft_stiffness_nmm2,
            tip_stiffness_nmm2=factor * wire.tip_stiffness_nmm2,
        )

    def _rules(self) -> dict[str, Any]:
        return {
            "image_size": self.image_size,
            "max_steps": self.max_steps,
            "success_radius": self.success_radius,
            "start_jitter": self.start_jitter,
            "start_rotation": self.start_rotation,
        }

    def training_environment(
        self, anatomies: Sequence[int], observation: tuple[str, ...], accuracy: str | None = None
    ) -> NavigateManyEnv:
        """An environment over random arches with the shaped reward."""
        from cathsim.variety import NavigateManyEnv

        return NavigateManyEnv(
            [training_arch(seed) for seed in anatomies],
            self.targets,
            (self.wire("default"),),
            resolution=RESOLUTION,
            accuracy=accuracy or self.accuracy,
            observation=observation,
            reward=REWARD_OF_TRAINING,
            **self._rules(),
        )

    def test_environment(self, phantom: str | int, target: str, wire: str, observation: tuple[str, ...]) -> NavigateEnv:
        """An environment of a test: a named phantom, a mesh's path, or the seed of a random arch."""
        from cathsim import NavigateEnv

        named = {"phantom": phantom} if isinstance(phantom, str) else {"phantom": TEST_PHANTOM, "phantom_seed": phantom}
        return NavigateEnv(
            **named,
            target=target,
            wire=self.wire(wire),
            observation=observation,
            reward=REWARD_OF_EVALUATION,
            **self._rules(),
        )
