"""Image policy: a recurrent policy and the perception that it learnt with, from one file, ready to steer."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import torch

from enn.bounded_content import built_from
from enn.imitation.images.perception import ImagePerception
from enn.imitation.recurrent_policy import RecurrentController, RecurrentPolicy
from enn.model_file import UNFIT, another_architecture


class ImagePolicy(NamedTuple):
    """A policy that steers by images alone.

    Attributes:
        perception: images to features.
    """

    policy: RecurrentPolicy
    perception: ImagePerception

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> ImagePolicy:
        """Reads a policy that sees images, and its perception, onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged, holds something else, or is of another architecture.
        """
        policy = RecurrentPolicy.load(path, device)
        try:
            with built_from(policy.perception):
                return cls(policy, ImagePerception.of(policy.perception, device))
        except UNFIT as error:
            raise another_architecture(Path(path), error, verb="train") from error

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the observations that it sees."""
        return self.perception.keys

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the views whose images it sees."""
        return self.perception.cameras

    @property
    def imaging(self) -> dict[str, Any]:
        """How its X-ray images are taken: `views`, their names, and `field`, m, or None for all of the anatomy."""
        return {"views": self.cameras, "field": self.perception.field}

    @property
    def action_repeat(self) -> int:
        """Environment steps that each action is meant for."""
        return self.policy.settings.action_repeat

    @property
    def metadata(self) -> dict[str, Any]:
        """What its file says of its training."""
        return self.policy.metadata

    def controller(self) -> RecurrentController:
        """The policy over episodes; call its `reset()` at the start of each."""
        return self.perception.controller(self.policy)
