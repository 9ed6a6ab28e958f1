"""Image perception: the egocentric view of an episode as a recurrent policy's features.

There are two kinds. One observes the wire's mask and finds the lumen in the episode's first image. The other has X-ray
images alone, and from before the episode a contrast run: an image without wire or contrast medium, and one with
contrast medium in the vessels. It finds wire and lumen by networks of its own, the lumen in the image with contrast
medium or in what that image has less light than the one before (`subtracted`), in which nothing else is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from enn.imitation.egocentric import EgocentricView, without_wire
from enn.imitation.lumen_segmentation import LumenSegmenter
from enn.imitation.recurrent_policy import Observation, RecurrentController, RecurrentPolicy
from enn.imitation.wire_segmentation import WireSegmenter
from enn.model_file import UNFIT, another_architecture

IMAGE_KEYS = ("image", "mask", "goal_image")  # observations of a policy that observes the wire's mask
XRAY_KEYS = ("image", "plain", "contrast", "goal_image")  # ... and of one that finds wire and lumen itself
_DARKEST = 10.0  # grey levels, added to both images of a quotient: where no light falls it is 1


def subtracted(plain: NDArray[np.uint8], contrast: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The image of a contrast run without what stood still: about 100 where no contrast medium is, less where it is.

    Args:
        plain: grey levels before the contrast medium came. Shape (..., size, size).
        contrast: with it; of the same shape.
    """
    return np.float32(100.0) * (contrast.astype(np.float32) + _DARKEST) / (plain.astype(np.float32) + _DARKEST)


class ImagePerception:
    """Segmenters and egocentric view: from images to `enn.imitation.egocentric.VIEW_SIZE` features.

    Args:
        segmenter: finds the lumen in an episode's first image, or in that of a contrast run.
        wire: finds the wire in every image; None: the mask is observed.
        subtracts: whether the lumen is looked for in `subtracted` images of contrast runs.
    """

    def __init__(
        self,
        segmenter: LumenSegmenter,
        wire: WireSegmenter | None = None,
        device: torch.device | str = "cpu",
        *,
        subtracts: bool = False,
    ) -> None:
        self.segmenter, self.subtracts = segmenter.to(device), subtracts
        self.wire = None if wire is None else wire.to(device)

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the observations that it sees."""
        return IMAGE_KEYS if self.wire is None else XRAY_KEYS

    def mask(self, observation: Observation) -> NDArray[np.uint8]:
        """The wire's pixels, not 0, as observed or found. Shape (1, size, size)."""
        if self.wire is None:
            return observation["mask"]
        return self.wire.mask(observation["image"][0], observation["plain"][0])[None]

    def begin(self, observation: Observation) -> EgocentricView:
        """The view of an episode, from its first observation.

        Raises:
            ValueError: an image is missing.
        """
        missing = [key for key in self.keys if key not in observation]
        if missing:
            raise ValueError(
                f"the policy sees {', '.join(self.keys)}, but {', '.join(missing)} is missing: make the environment "
                "with these observations"
            )
        image, mask, dot = observation["image"], self.mask(observation), observation["goal_image"]
        view = EgocentricView()
        empty = None if self.wire is None else observation["plain"]
        view.start(image, mask, dot, self.lumen(observation, mask), empty=empty)
        return view

    def lumen(self, observation: Observation, mask: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probability of the lumen, shape (size, size), by an episode's first observation and the wire's mask in it."""
        if self.wire is None:
            return self.segmenter.lumen(without_wire(observation["image"][0], mask[0] > 0))
        contrast = observation["contrast"][0]
        return self.segmenter.lumen(subtracted(observation["plain"][0], contrast) if self.subtracts else contrast)

    def __call__(
        self, views: Sequence[EgocentricView], observations: Sequence[Observation], actions: Sequence[NDArray[Any]]
    ) -> NDArray[np.float32]:
        """Features of N episodes' moment, as `enn.imitation.recurrent_policy.Perception` says."""
        moments = zip(views, observations, actions, strict=True)
        return np.stack([view.look(seen["image"], self.mask(seen), action) for view, seen, action in moments])

    def controller(self, policy: RecurrentPolicy) -> RecurrentController:
        """A policy on this perception over episodes."""
        return RecurrentController(policy, self, self.begin)

    def content(self) -> dict[str, Any]:
        """What a policy's file keeps: settings and weights of the segmenters."""
        return {
            "segmenter": {
                "settings": [self.segmenter.width, self.segmenter.working_size],
                "weights": self.segmenter.state_dict(),
            },
            "wire": None if self.wire is None else {"width": self.wire.width, "weights": self.wire.state_dict()},
            "subtracts": self.subtracts,
        }

    @classmethod
    def of(cls, content: dict[str, Any], device: torch.device | str = "cpu") -> ImagePerception:
        """The perception that `content` was taken from.

        Raises:
            AttributeError, KeyError, RuntimeError, TypeError: something else, or of another architecture.
        """
        segmenter = LumenSegmenter(*content["segmenter"]["settings"])
        segmenter.load_state_dict(content["segmenter"]["weights"])
        wire = None
        if content["wire"] is not None:
            wire = WireSegmenter(content["wire"]["width"])
            wire.load_state_dict(content["wire"]["weights"])
            wire.eval()
        return cls(segmenter.eval(), wire, device, subtracts=bool(content.get("subtracts", False)))  # older files: not


def load_image_policy(path: Path | str, device: torch.device | str = "cpu") -> tuple[RecurrentPolicy, ImagePerception]:
    """Reads a policy that sees images, and its perception, onto a device.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, holds something else, or is of another architecture.
    """
    policy = RecurrentPolicy.load(path, device)
    try:
        return policy, ImagePerception.of(policy.perception, device)
    except UNFIT as error:
        raise another_architecture(Path(path), error, verb="train") from error
