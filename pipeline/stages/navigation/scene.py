"""Scene of the autonomous navigation: a phantom under the data set's C-arms, its contrast run, and the target's mark.

The navigator is given what a scene's `images`, `marks` and `vessels` hold, and nothing else of the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.lifetime_cache import kept_with_owner

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.anatomy import Phantom
    from cathsim.fluoroscopy import BiplaneFluoroscope
    from splineformer.navigation.space_map import Hull, SpaceMap
    from splineformer.navigation.vessel_map import VesselMap

CAMERAS = ("a", "b")
_RUN_SEED = 7  # of the contrast run's noise
_BEHIND_M = 0.3  # m of wire outside the body, which no image shows the end of


@dataclass(frozen=True)
class Rig:
    """How the navigator's images are made.

    Attributes:
        cameras: of the public data set's geometry.
        image_size_px: side of the images.
        filling: of the lumen while the wire moves, "fluid" (clear) or "air".
        wire: preset whose material is drawn.
    """

    cameras: tuple[str, ...] = ("a",)
    image_size_px: int = 1024
    filling: str = "fluid"
    wire: str = "default"


@kept_with_owner
def fluoroscope_of(phantom: Phantom, rig: Rig, filling: str) -> BiplaneFluoroscope:
    """The cameras over a phantom whose lumen holds "fluid", "contrast" or "air"."""
    return _fluoroscope(phantom, rig, filling)


def _fluoroscope(phantom: Phantom, rig: Rig, filling: str) -> BiplaneFluoroscope:
    from cathsim import load_guidewire
    from cathsim.fluoroscopy import BiplaneFluoroscope, askew_pair, radiograph, scene, wire_material

    x, y, z = phantom.bounds.mean(axis=0).tolist()
    every = askew_pair((x, y, z), rig.image_size_px, distorted=False)
    cameras = [every[name] for name in rig.cameras]
    what = scene("bath", filling)
    stills = [radiograph(phantom.grid, camera, what, key=phantom.hash) for camera in cameras]
    material = wire_material(rig.wire, load_guidewire(rig.wire).radius)
    return BiplaneFluoroscope(cameras, stills, material=material, centre=(x, y, z))


@kept_with_owner
def vessels_of(phantom: Phantom, target: str, rig: Rig) -> dict[str, VesselMap]:
    """The contrast run before the procedure as a map a camera, with the target marked."""
    from splineformer.navigation.vessel_map import VesselMap

    lumens, marks = _lumens(phantom, rig), marks_of(phantom, target, rig)
    return {name: VesselMap(lumens[name], marks[name]) for name in rig.cameras}


@kept_with_owner
def space_of(phantom: Phantom, target: str, rig: Rig) -> SpaceMap | None:
    """The contrast run of both cameras as one map in space; None where there is one camera."""
    from splineformer.navigation.space_map import SpaceMap

    if len(rig.cameras) != 2:
        return None
    marks = marks_of(phantom, target, rig)
    return SpaceMap(_hull(phantom, rig), [marks[name] for name in rig.cameras])


@kept_with_owner
def _hull(phantom: Phantom, rig: Rig) -> Hull:
    from guide3d.geometry.camera import Camera
    from splineformer.navigation.space_map import hull_of

    size, seen = rig.image_size_px, fluoroscope_of(phantom, rig, rig.filling).cameras
    known = [
        Camera(seen[name].projector.K, seen[name].projector.R, 1e3 * seen[name].projector.t, size, size, name)
        for name in rig.cameras
    ]
    lumens = _lumens(phantom, rig)
    return hull_of([lumens[name] for name in rig.cameras], known)


@kept_with_owner
def _lumens(phantom: Phantom, rig: Rig) -> dict[str, np.ndarray]:
    from splineformer.navigation.vessel_map import lumen_of_run

    nothing = np.empty((0, 3))
    plain = fluoroscope_of(phantom, rig, rig.filling).render(nothing, _RUN_SEED)
    # filled with contrast medium it is seen once: nothing of that is kept
    contrast = _fluoroscope(phantom, rig, "contrast").render(nothing, _RUN_SEED + 1)
    return {name: lumen_of_run(plain[name].image, contrast[name].image) for name in rig.cameras}


def marks_of(phantom: Phantom, target: str, rig: Rig) -> dict[str, np.ndarray]:
    """Where each camera shows the target, as shares of the image's sides."""
    cameras = fluoroscope_of(phantom, rig, rig.filling).cameras
    place = phantom.target(target).position[None]
    return {name: (camera.pixels(place)[0] + 0.5) / rig.image_size_px for name, camera in cameras.items()}


def images_of_shape(phantom: Phantom, rig: Rig, nodes: np.ndarray, seed: Any) -> list[np.ndarray]:
    """Images of a wire in a phantom.

    Args:
        phantom: the anatomy.
        rig: of the cameras.
        nodes: (n, 3) m, from the tip, the part in the sheath included.
        seed: of the noise.

    Returns:
        An image a camera, in the rig's order.
    """
    frames = fluoroscope_of(phantom, rig, rig.filling).render(nodes, np.random.default_rng(seed))
    return [frames[name].image for name in rig.cameras]


def with_shaft(nodes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """A logged wire with its shaft outside the body: (n, 3) m nodes from the tip, and the entry's direction inwards."""
    return np.concatenate((nodes, nodes[-1:] - _BEHIND_M * direction))


@dataclass(eq=False)
class Scene:
    """An environment under the cameras.

    Args:
        environment: with the cameras that `scene_environment` gives it.
        rig: of them.
    """

    environment: NavigateEnv
    rig: Rig
    target: str = field(init=False)

    def __post_init__(self) -> None:
        self.target = self.environment.task.target_name

    def images(self) -> list[np.ndarray]:
        """The moment's image of each camera."""
        view = self.environment.biplane
        assert view is not None
        return [view.frame(name).image for name in self.rig.cameras]

    @property
    def marks(self) -> dict[str, np.ndarray]:
        """The target's mark in each camera."""
        return marks_of(self.environment.phantom, self.target, self.rig)

    @property
    def vessels(self) -> dict[str, VesselMap]:
        """The contrast run's map of each camera."""
        return vessels_of(self.environment.phantom, self.target, self.rig)

    @property
    def space(self) -> SpaceMap | None:
        """The contrast runs' map in space, of two cameras."""
        return space_of(self.environment.phantom, self.target, self.rig)


def scene_environment(
    phantom: Phantom, target: str, rig: Rig, observation: Sequence[str], **arguments: Any
) -> NavigateEnv:
    """An environment whose bi-planar view is the rig's.

    Args:
        phantom: the anatomy.
        target: of the task.
        rig: of the cameras.
        observation: of a teacher; the navigator's own images are drawn when asked for.
        arguments: of `NavigateEnv`.
    """
    from cathsim import NavigateEnv

    cameras = fluoroscope_of(phantom, rig, rig.filling)
    return NavigateEnv(phantom, target, observation=tuple(observation), cameras=cameras, **arguments)
