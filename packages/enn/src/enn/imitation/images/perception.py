"""Image perception: the egocentric views of an episode, one of each camera, as a recurrent policy's features.

There are two kinds. One observes the wire's mask and finds the lumen in the episode's first image. The other has X-ray
images alone, and from before the episode a contrast run: an image without wire or contrast medium, and one with
contrast medium in the vessels. It finds wire and lumen by networks of its own, the lumen in the image with contrast
medium or in what that image has less light than the one before (`subtracted`), in which nothing else is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from enn.imitation.images.egocentric import CATHETER_SIZE, VIEW_SIZE, EgocentricView
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.stereo_geometry import StereoGeometry
from enn.imitation.images.stereo_view import CATHETER_SIZE as STEREO_CATHETER_SIZE
from enn.imitation.images.stereo_view import STEREO_SIZE, StereoView
from enn.imitation.images.visual_hull import SeenVoxels
from enn.imitation.images.wire_segmentation import WireSegmenter
from enn.imitation.images.wire_tracing import without_wire
from enn.imitation.recurrent_policy import Observation, RecurrentController, RecurrentPolicy
from enn.networks.observation_spaces import require_keys

IMAGE_KEYS = ("image", "mask", "goal_image")  # observations of a policy that observes the wire's mask
XRAY_KEYS = ("image", "plain", "contrast", "goal_image")  # ... and of one that finds wire and lumen itself
ONE_CAMERA = ("frontal",)
_OF_WIRE = 2  # actions
_DARKEST = 10.0  # grey levels, added to both images of a quotient: where no light falls it is 1


def subtracted(plain: NDArray[np.uint8], contrast: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The image of a contrast run without what stood still: about 100 where no contrast medium is, less where it is.

    Args:
        plain: grey levels before the contrast medium came. Shape (..., size, size).
        contrast: with it; of the same shape.
    """
    return np.float32(100.0) * (contrast.astype(np.float32) + _DARKEST) / (plain.astype(np.float32) + _DARKEST)


@dataclass(frozen=True, eq=False)
class ImageViews:
    """What is kept of an episode: the view of each camera, and where two cameras are calibrated what both show."""

    cameras: list[EgocentricView]
    stereo: StereoView | None = None


class ImagePerception:
    """Segmenters and egocentric views: from images to features.

    There are `enn.imitation.images.egocentric.VIEW_SIZE` of each camera; where two are calibrated there follow the
    `enn.imitation.images.stereo_view.STEREO_SIZE` of both.

    Args:
        segmenter: finds the lumen in an episode's first image, or in that of a contrast run.
        wire: finds the wire in every image, and a catheter over it; None: the mask is observed.
        catheter: finds the catheter alone; None: there is none.
        field: side of the square that X-ray images show in the plane of the isocentre, m; None: all of the anatomy.
        subtracts: whether the lumen is looked for in `subtracted` images of contrast runs.
        cameras: names of the views whose images, one after the other, are the first axis of every observation.
        projections: of two cameras, as of `enn.imitation.images.stereo_geometry.StereoGeometry`; None: what they show
            together is not looked at.

    Raises:
        ValueError: projections without a field, or of other than two cameras.
    """

    def __init__(
        self,
        segmenter: LumenSegmenter,
        wire: WireSegmenter | None = None,
        device: torch.device | str = "cpu",
        *,
        subtracts: bool = False,
        cameras: Sequence[str] = ONE_CAMERA,
        catheter: WireSegmenter | None = None,
        field: float | None = None,
        projections: ArrayLike | None = None,
    ) -> None:
        self.voxels: SeenVoxels | None = None
        if projections is not None:
            if field is None or len(cameras) != 2:
                raise ValueError("projections: expected two cameras with a field of view")
            self.voxels = SeenVoxels(StereoGeometry(np.asarray(projections, float), field))
        self.segmenter, self.subtracts, self.cameras = segmenter.to(device), bool(subtracts), tuple(cameras)
        self.field = field
        self.wire, self.catheter = (None if one is None else one.to(device) for one in (wire, catheter))

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the observations that it sees."""
        return IMAGE_KEYS if self.wire is None else XRAY_KEYS

    @property
    def size(self) -> int:
        """Number of features."""
        together = 0 if self.voxels is None else STEREO_SIZE
        if self.catheter is None:
            return len(self.cameras) * VIEW_SIZE + together
        together += 0 if self.voxels is None else STEREO_CATHETER_SIZE
        return len(self.cameras) * (VIEW_SIZE + CATHETER_SIZE) + together + _OF_WIRE  # as many actions of the catheter

    def mask(self, observation: Observation) -> NDArray[np.uint8]:
        """The devices' pixels, not 0, as observed or found. Shape (cameras, size, size)."""
        return observation["mask"] if self.wire is None else _found(self.wire, observation)

    def begin(self, observation: Observation) -> ImageViews:
        """The views of an episode from its first observation.

        Raises:
            ValueError: an image is missing, or there are images of more or fewer cameras.
        """
        require_keys(self.keys, observation)
        if len(observation["image"]) != len(self.cameras):
            raise ValueError(
                f"the policy sees the views {', '.join(self.cameras)}, got {len(observation['image'])} of them: make "
                "the environment with these views"
            )
        masks = self.mask(observation)
        views = [self._begun(observation, masks, camera) for camera in range(len(self.cameras))]
        if self.voxels is None:
            return ImageViews(views)
        dots = [view.target + 0.5 / view.size for view in views]  # from a pixel's number to its middle
        return ImageViews(views, StereoView(self.voxels, [view.lumen for view in views], dots))

    def _begun(self, observation: Observation, masks: NDArray[np.uint8], camera: int) -> EgocentricView:
        own = slice(camera, camera + 1)
        image, mask, dot = observation["image"][own], masks[own], observation["goal_image"][own]
        view = EgocentricView()
        empty = None if self.wire is None else observation["plain"][own]
        view.start(image, mask, dot, self.lumen(observation, mask, camera), empty=empty)
        return view

    def lumen(self, observation: Observation, mask: NDArray[np.uint8], camera: int = 0) -> NDArray[np.float32]:
        """Probability of the lumen in a camera's image.

        Args:
            observation: an episode's first.
            mask: the wire's in that camera. Shape (1, size, size).

        Returns:
            Shape (size, size).
        """
        if self.wire is None:
            return self.segmenter.lumen(without_wire(observation["image"][camera], mask[0] > 0))
        contrast = observation["contrast"][camera]
        return self.segmenter.lumen(subtracted(observation["plain"][camera], contrast) if self.subtracts else contrast)

    def __call__(
        self,
        views: Sequence[ImageViews],
        observations: Sequence[Observation],
        actions: Sequence[NDArray[Any]],
    ) -> NDArray[np.float32]:
        """Features of N episodes' moment, as `enn.imitation.recurrent_policy.Perception` says."""
        return np.stack([self._look(*moment) for moment in zip(views, observations, actions, strict=True)])

    def _look(self, views: ImageViews, seen: Observation, action: NDArray[Any]) -> NDArray[np.float32]:
        images, masks, of_wire = seen["image"], self.mask(seen), action[:_OF_WIRE]
        tubes = None if self.catheter is None else _found(self.catheter, seen)
        parts = []
        for k, view in enumerate(views.cameras):
            own = slice(k, k + 1)
            parts.append(view.look(images[own], masks[own], of_wire, None if tubes is None else tubes[own]))
        if views.stereo is not None:
            arcs = [view.catheter_arc for view in views.cameras]
            ends = None if tubes is None else (float(arcs[0] or 0.0), float(arcs[1] or 0.0))
            parts.append(views.stereo.look([view.axis for view in views.cameras], ends))
        return np.concatenate(parts if tubes is None else [*parts, action[_OF_WIRE:]])

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
            "wire": _kept(self.wire),
            "catheter": _kept(self.catheter),
            "subtracts": self.subtracts,
            "cameras": list(self.cameras),
            "field": self.field,
            "projections": None if self.voxels is None else self.voxels.geometry.projections.tolist(),
        }

    @classmethod
    def of(cls, content: dict[str, Any], device: torch.device | str = "cpu") -> ImagePerception:
        """The perception that `content` was taken from.

        Raises:
            AttributeError, KeyError, RuntimeError, TypeError: something else, or of another architecture.
        """
        segmenter = LumenSegmenter(*content["segmenter"]["settings"])
        segmenter.load_state_dict(content["segmenter"]["weights"])
        wire, catheter = _read(content["wire"]), _read(content["catheter"])
        further: dict[str, Any] = {name: content[name] for name in ("subtracts", "cameras", "field", "projections")}
        return cls(segmenter.eval(), wire, device, catheter=catheter, **further)


def _found(network: WireSegmenter, observation: Observation) -> NDArray[np.uint8]:
    pairs = zip(observation["image"], observation["plain"], strict=True)
    return np.stack([network.mask(image, plain) for image, plain in pairs])


def _kept(network: WireSegmenter | None) -> dict[str, Any] | None:
    return None if network is None else {"width": network.width, "weights": network.state_dict()}


def _read(content: dict[str, Any] | None) -> WireSegmenter | None:
    if content is None:
        return None
    network = WireSegmenter(content["width"])
    network.load_state_dict(content["weights"])
    return network.eval()
