"""The still part of a radiograph: photons that every pixel expects from a scene without a wire."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cathsim.fluoroscopy.attenuation import DistanceGrid, Keyed, lumen_path_length
from cathsim.fluoroscopy.c_arms import XRayCamera
from cathsim.fluoroscopy.projector import Projector
from cathsim.fluoroscopy.scene import XRayScene, body_depth

DepthFunction = Callable[[Projector], NDArray[np.float32]]

_MARGIN = 3  # px around the ideal image, for interpolation
_SCATTER_SPREAD = 0.12  # of the image's side: scattered light varies slowly
_SCREEN_GLARE = 0.05  # share of light that strays inside the detector
_EXPOSED = 0.2  # of the image on each side, left out where the exposure is measured
_REACH = 4.0  # of a Gaussian's spreads, beyond which it counts as 0
_BODY_STRIDE = 2  # px between the rays on which the body is integrated; it has no finer detail


@dataclass(frozen=True, eq=False)
class Radiograph:
    """Expected photon counts, behind the detector's distortion and before its screen's blur."""

    # (height, width) float32, photons that passed straight; a wire in the way multiplies them
    primary: NDArray[np.float32]
    veil: NDArray[np.float32]  # (height, width) float32, scatter and glare, which a thin wire leaves as it is

    def __post_init__(self) -> None:
        for array in (self.primary, self.veil):
            array.flags.writeable = False


def optical_depth(
    grid: DistanceGrid, projector: Projector, scene: XRayScene, raised: float = 0.0
) -> NDArray[np.float32]:
    """Optical depth (height, width) of a scene for every pixel of a pinhole camera.

    Args:
        raised: how far the scene's body stands above the middle of the grid, m.
    """
    depth = np.zeros((projector.height, projector.width), np.float32)
    if scene.body:
        centre = np.asarray(grid.origin) + (np.array(grid.blocks.shape) - 1) * grid.spacing / 2 + (0.0, 0.0, raised)
        coarse = _every(projector, _BODY_STRIDE)
        depth += _between(body_depth(coarse, scene.body, centre), _BODY_STRIDE, depth.shape)
    if scene.filling or scene.wall:
        lumen = _path_length(grid, projector, 0.0)
        depth += np.float32(scene.filling) * lumen
        if scene.wall and scene.wall_thickness:
            outer = _path_length(grid, projector, -scene.wall_thickness)
            depth += np.float32(scene.wall) * (outer - lumen)
    return depth


def _path_length(grid: DistanceGrid, projector: Projector, level: float) -> NDArray[np.float32]:
    """As `lumen_path_length`; a scene and its contrast run, one after the other, share it."""
    return _integrated(Keyed((id(grid), projector.key, level), grid, projector, level))


@lru_cache(maxsize=4)  # which keeps the grids, so that their ids stay theirs
def _integrated(request: Keyed) -> NDArray[np.float32]:
    grid, projector, level = request.arguments
    length = lumen_path_length(grid, projector, level=level)
    length.flags.writeable = False
    return length


def radiograph(grid: DistanceGrid, camera: XRayCamera, scene: XRayScene, *, key: str | None = None) -> Radiograph:
    """Photons that a camera's detector expects of a scene.

    Args:
        key: content hash of the phantom; radiographs of the same key, camera and scene are computed once a process.
    """
    if key is None:
        return expose_depth(camera, scene, lambda projector: optical_depth(grid, projector, scene))
    return _cached(Keyed((key, camera.projector.key, camera.distortion, camera.detector, scene), grid, camera, scene))


@lru_cache(maxsize=16)
def _cached(request: Keyed) -> Radiograph:
    return radiograph(*request.arguments)


def expose_depth(camera: XRayCamera, scene: XRayScene, depth_of: DepthFunction) -> Radiograph:
    """Turns optical depths into expected photons: distortion, focal blur, exposure, scatter, collimator.

    Args:
        depth_of: optical depth of every pixel of the pinhole camera it is given, (height, width).
    """
    projector, detector = camera.projector, camera.detector
    width, height = projector.width, projector.height
    passed = _distorted(camera, depth_of)
    if detector.focal_blur:
        passed = _blurred(passed, detector.focal_blur * detector.scale(width, height))
    light = detector.illumination(width, height)
    spread, lit = _SCATTER_SPREAD * min(width, height), (light > 0).astype(np.float32)
    if detector.equalisation:
        passed = passed * np.power(_wide_blur(passed, spread), -np.float32(detector.equalisation))
    # scatter comes from the lit part of the body alone
    strayed = _wide_blur(passed * lit, spread) / np.maximum(_wide_blur(lit, spread), 1e-3)
    rows, columns = (slice(int(_EXPOSED * n), n - int(_EXPOSED * n)) for n in passed.shape)
    share = np.float32(1 - (1 - scene.scatter) * (1 - _SCREEN_GLARE))
    seen = (1 - share) * passed + share * strayed
    white = detector.white(width, height)
    gain = np.float32(white * (scene.middle / 255) ** 2 / np.median((seen * light)[rows, columns]))
    dark = np.float32(white * (detector.glare / 255) ** 2)
    return Radiograph(
        np.ascontiguousarray(gain * (1 - share) * passed * light, dtype=np.float32),
        np.ascontiguousarray(gain * share * strayed * light + dark, dtype=np.float32),
    )


def _distorted(camera: XRayCamera, depth_of: DepthFunction) -> NDArray[np.float32]:
    """Share of photons that pass, in the distorted image."""
    from cathsim.viewing.opencv import cv2  # here, as only bi-planar views need it

    projector, distortion = camera.projector, camera.distortion
    if distortion.identity:
        return np.exp(-depth_of(projector))
    u, v = np.meshgrid(np.arange(projector.width), np.arange(projector.height))
    ideal = distortion.undistort(np.column_stack((u.ravel(), v.ravel())))
    low = np.floor(ideal.min(axis=0)).astype(int) - _MARGIN
    high = np.ceil(ideal.max(axis=0)).astype(int) + _MARGIN
    shift = np.array([[1.0, 0.0, -low[0]], [0.0, 1.0, -low[1]], [0.0, 0.0, 1.0]])
    width, height = (high - low + 1).tolist()
    passed = np.exp(-depth_of(replace(projector, K=shift @ projector.K, width=width, height=height)))
    x, y = (ideal - low).astype(np.float32).T.reshape(2, projector.height, projector.width)
    image = cv2.remap(passed, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(image, np.float32)


def _every(projector: Projector, stride: int) -> Projector:
    """The camera that sees every `stride`-th pixel's centre, and one row and column more."""
    scale = np.diag([1 / stride, 1 / stride, 1.0])
    width, height = projector.width // stride + 2, projector.height // stride + 2
    return replace(projector, K=scale @ projector.K, width=width, height=height)


def _wide_blur(image: NDArray[np.float32], spread: float) -> NDArray[np.float32]:
    """A Gaussian blur wide enough to be computed on every eighth pixel."""
    stride = max(1, int(spread // 8))
    return _between(_blurred(np.ascontiguousarray(image[::stride, ::stride]), spread / stride), stride, image.shape)


def _blurred(image: NDArray[np.float32], spread: float) -> NDArray[np.float32]:
    """A Gaussian blur of `spread` px; the border's pixels go on outside."""
    from cathsim.viewing.opencv import cv2  # here, as only bi-planar views need it

    side = 2 * int(_REACH * spread + 0.5) + 1
    return np.asarray(cv2.GaussianBlur(image, (side, side), spread, borderType=cv2.BORDER_REPLICATE), np.float32)


def _between(image: NDArray[np.float32], stride: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """What lies between every `stride`-th pixel, which the image has: (height, width) of `shape`, bilinear."""
    from cathsim.viewing.opencv import cv2

    way, scale = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, np.array([[1 / stride, 0.0, 0.0], [0.0, 1 / stride, 0.0]])
    wide = cv2.warpAffine(image, scale, shape[::-1], flags=way, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(wide, np.float32)
