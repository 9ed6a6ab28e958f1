"""Images of a navigation by the data set's C-arms: of a wire's shape, and of the contrast run before the procedure."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.environment import NavigateEnv
from cathsim.fluoroscopy import BiplaneFluoroscope, askew_pair, scene, wire_material
from cathsim.fluoroscopy.radiograph import expose_depth, optical_depth
from cathsim.guidewire import load_guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.validation import Pixels, settings

Result = TypeVar("Result")

_RUN_SEED = 7  # of the contrast run's noise
_NOTHING = np.empty((0, 3))  # no wire
_EVEN, _DARK = 180, 24  # grey levels: of what is the same in both images, and of the field's rim
_BEHIND_M = 0.3  # m of wire outside the body, which no image shows the end of


@dataclass(frozen=True, eq=False)
class CArmClutter:
    """What lies in the way of the cameras and stands still; equal to itself alone, so that images can be kept by it.

    Attributes:
        attenuation: (size, size) of each camera.
    """

    attenuation: tuple[NDArray[np.float32], ...]


@settings
class CArms:
    """How the images are made.

    Attributes:
        cameras: names, "a" and "b" of the public data set's geometry.
        filling: of the lumen while the wire moves, "fluid" (clear) or "air".
        wire: preset whose material is drawn.
        clutter: in the way of each camera, also in the contrast run; None: there is none.
        subtracted: images are divided by the contrast run's image without a wire, so that what stands still is gone.
    """

    cameras: tuple[str, ...] = ("a",)
    image_size_px: Pixels = 1024
    filling: str = "fluid"
    wire: str = "default"
    clutter: CArmClutter | None = None
    subtracted: bool = False

    def __post_init__(self) -> None:
        """Refuses clutter of other cameras or another size."""
        if self.clutter is not None:
            shapes, side = [one.shape for one in self.clutter.attenuation], self.image_size_px
            if shapes != [(side, side)] * len(self.cameras):
                raise ValueError(
                    f"clutter must have shape ({side}, {side}) for each camera of {self.cameras}, got {shapes}"
                )


def _kept_with_clutter(make: Callable[[Phantom, CArms], Result]) -> Callable[[Phantom, CArms], Result]:
    """Makes a function remember its results for as long as the clutter is in use, or the phantom without any.

    Args:
        make: its result must refer to neither.
    """
    bare = kept_with_owner(make)

    @kept_with_owner
    def among(clutter: CArmClutter, phantom: Phantom, arms: CArms) -> Result:
        return make(phantom, replace(arms, clutter=clutter))

    @functools.wraps(make)
    def look_up(phantom: Phantom, arms: CArms) -> Result:
        if arms.clutter is None:
            return bare(phantom, arms)
        return among(arms.clutter, phantom, replace(arms, clutter=None))

    return look_up


@_kept_with_clutter
def fluoroscope_of(phantom: Phantom, arms: CArms) -> BiplaneFluoroscope:
    """The cameras over a phantom while the wire moves."""
    return _fluoroscope(phantom, arms, arms.filling)


def _fluoroscope(phantom: Phantom, arms: CArms, filling: str) -> BiplaneFluoroscope:
    centre = phantom.bounds.mean(axis=0)
    pair = askew_pair(centre, arms.image_size_px, distorted=False)
    cameras, around = [pair[name] for name in arms.cameras], scene("bath", filling)
    material = wire_material(arms.wire, load_guidewire(arms.wire).radius)
    if arms.clutter is None:
        return BiplaneFluoroscope.over(phantom, cameras, around, material)
    depths = [
        optical_depth(phantom.grid, camera.projector, around) + clutter
        for camera, clutter in zip(cameras, arms.clutter.attenuation, strict=True)
    ]
    stills = [
        expose_depth(camera, around, lambda _, depth=depth: depth)  # type: ignore[misc]
        for camera, depth in zip(cameras, depths, strict=True)
    ]
    return BiplaneFluoroscope(cameras, stills, material=material, centre=centre)


def contrast_images(phantom: Phantom, arms: CArms) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """The contrast run before a procedure: of each camera an image without wire or contrast medium, and one with it."""
    # filled with contrast medium it is seen once: nothing of that is kept
    contrast = _fluoroscope(phantom, arms, "contrast").render(_NOTHING, _RUN_SEED + 1)
    plain = _plain_images(phantom, arms)
    return {name: (image, contrast[name].image) for name, image in zip(arms.cameras, plain, strict=True)}


def _plain_images(phantom: Phantom, arms: CArms) -> list[NDArray[np.uint8]]:
    """The contrast run's images without wire or contrast medium, (size, size) of each camera."""
    frames = fluoroscope_of(phantom, arms).render(_NOTHING, _RUN_SEED)
    return [frames[name].image for name in arms.cameras]


def marks_of(phantom: Phantom, target: str, arms: CArms) -> dict[str, np.ndarray]:
    """Where each camera shows the target, (2,) x and y as shares of the image's sides."""
    place = phantom.target(target).position[None]
    cameras = fluoroscope_of(phantom, arms).cameras
    return {name: (camera.pixels(place)[0] + 0.5) / arms.image_size_px for name, camera in cameras.items()}


def images_of_shape(phantom: Phantom, arms: CArms, nodes: np.ndarray, seed: Any) -> list[NDArray[np.uint8]]:
    """Images of a wire in a phantom.

    Args:
        arms: whose cameras see it.
        nodes: (n, 3) m, from the tip, the part in the sheath included.

    Returns:
        An image a camera, in the order of `arms.cameras`.
    """
    frames = fluoroscope_of(phantom, arms).render(nodes, np.random.default_rng(seed))
    return as_shown(phantom, arms, [frames[name].image for name in arms.cameras])


def as_shown(phantom: Phantom, arms: CArms, images: Sequence[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """What the C-arms show of the images that they take: the same, or what is left when they are subtracted.

    Args:
        images: (size, size), of each camera.
    """
    if not arms.subtracted:
        return list(images)
    return [_quotient(image, plain) for image, plain in zip(images, _kept_plain_images(phantom, arms), strict=True)]


_kept_plain_images = _kept_with_clutter(_plain_images)


def _quotient(image: NDArray[np.uint8], plain: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image (size, size) over another: `_EVEN` where they are equal, or the second is too dark to divide by."""
    from cathsim.viewing.opencv import cv2  # here, as only subtracted views need it

    even = np.asarray(cv2.divide(image, plain, scale=_EVEN), np.uint8)
    even[plain < _DARK] = _EVEN
    return even


def with_shaft(nodes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """A logged wire with its shaft outside the body: (n, 3) m nodes from the tip, and the entry's direction inwards."""
    return np.concatenate((nodes, nodes[-1:] - _BEHIND_M * direction))


def c_arm_environment(
    phantom: Phantom, target: str, arms: CArms, observation: Sequence[str], **arguments: Any
) -> NavigateEnv:
    """An environment whose bi-planar view is that of the C-arms, drawn when it is asked for.

    Args:
        arms: whose cameras see it.
        arguments: of `NavigateEnv`.
    """
    return NavigateEnv(
        phantom, target, observation=tuple(observation), cameras=fluoroscope_of(phantom, arms), **arguments
    )
