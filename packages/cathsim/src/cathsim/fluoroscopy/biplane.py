"""Bi-planar fluoroscopy: two cameras with real detectors look at one wire."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.attenuation import DistanceGrid
from cathsim.fluoroscopy.c_arms import PAIRS, XRayCamera
from cathsim.fluoroscopy.curve import ROUND_END, split
from cathsim.fluoroscopy.materials import WireMaterial, flat_marker, jacketed_wire
from cathsim.fluoroscopy.radiograph import Radiograph, radiograph
from cathsim.fluoroscopy.renderer import nodes_of
from cathsim.fluoroscopy.scene import XRayScene, scene
from cathsim.fluoroscopy.wire_shadow import ShadowWindow, WireShadow, overlaid
from cathsim.presets import MAXIMUM_SIZE, WIRE_RADIUS

_NORMALS = 4096


class Frame(NamedTuple):
    """One camera's view of a moment."""

    image: NDArray[np.uint8]
    """(height, width) grey levels"""
    mask: NDArray[np.uint8]
    """(height, width), 1 on the wire; in the same distorted pixels as the image"""


class DevicesFrame(NamedTuple):
    """One camera's view of a wire and a catheter; shapes (height, width), masks 0 or 1."""

    image: NDArray[np.uint8]
    """grey levels"""
    mask: NDArray[np.uint8]
    """1 on either"""
    mask_wire: NDArray[np.uint8]
    """1 on the wire, also where it lies in the catheter"""
    mask_catheter: NDArray[np.uint8]
    """1 on the catheter"""


class ImagedPhantom(Protocol):
    """What a phantom has to offer."""

    @property
    def grid(self) -> DistanceGrid:
        """Signed distance to the wall."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) m."""

    @property
    def hash(self) -> str:
        """Of its geometry."""


class _ExposureStruct(ctypes.Structure):
    """struct Exposure of fluoroscopy_detector.c."""

    _fields_ = (
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("primary", ctypes.c_void_p),
        ("veil", ctypes.c_void_p),
        *((name, ctypes.c_int) for name in ("left", "top", "wide", "high")),
        ("transmission", ctypes.c_void_p),
        ("white", ctypes.c_float),
        ("video", ctypes.c_float),
        ("counting", ctypes.c_int),
        ("radius", ctypes.c_int),
        ("kernel", ctypes.c_void_p),
        ("normal", ctypes.c_void_p),
    )


class BiplaneFluoroscope:
    """Images and masks of a wire from two (or more) cameras; safe to share between threads.

    The photons that every pixel expects of the scene are computed once. A frame multiplies those that passed straight
    by the wire's transmission, counts photons (Poisson), blurs as the intensifier's screen does, and shows the square
    root of the light with the display chain's noise. Image and mask are drawn from the same distorted curve.

    Args:
        cameras: the cameras; their names are the keys of what `render` returns.
        radiographs: what each expects of the scene.
        material: of the wire; by default nitinol in a tungsten-filled jacket.
        catheter: material of the catheter that `render_devices` draws; None: there is none.
        centre: (3,) m, the middle of where the devices will be.

    Attributes:
        recipe: the arguments of `of`, where that has made it; of others None.

    Raises:
        ValueError: for no cameras, a name twice, sizes that do not fit or exceed 4,096 px.
    """

    def __init__(
        self,
        cameras: Sequence[XRayCamera],
        radiographs: Sequence[Radiograph],
        *,
        material: WireMaterial | None = None,
        catheter: WireMaterial | None = None,
        centre: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        names = [camera.name for camera in cameras]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"cameras must have names of their own, got {names}.")
        if len(radiographs) != len(cameras):
            raise ValueError(f"expected a radiograph a camera, got {len(radiographs)} for {len(cameras)} cameras.")
        for camera, still in zip(cameras, radiographs, strict=True):
            shape = (camera.projector.height, camera.projector.width)
            if max(shape) > MAXIMUM_SIZE:
                raise ValueError(f"images may have at most {MAXIMUM_SIZE} px a side, got {shape}.")
            if still.primary.shape != shape or still.veil.shape != shape:
                raise ValueError(f"camera {camera.name} has {shape} px and its radiograph {still.primary.shape}.")
        self._centre = np.array(centre, float)
        self.cameras = {camera.name: camera for camera in cameras}
        self.material = material or jacketed_wire(WIRE_RADIUS)
        self._stills = dict(zip(names, radiographs, strict=True))
        self._shadows = {camera.name: WireShadow(camera, self.material, centre) for camera in cameras}
        self.catheter = catheter
        tube = None if catheter is None else flat_marker(catheter)
        self._tubes = (
            {} if tube is None else {camera.name: WireShadow(camera, tube, centre, hollow=True) for camera in cameras}
        )
        self._kernels = {camera.name: _kernel(camera) for camera in cameras}
        self._expose = _native_expose()
        self.recipe: dict[str, Any] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        make = functools.partial(type(self), material=self.material, catheter=self.catheter, centre=self._centre)
        return make, (tuple(self.cameras.values()), tuple(self._stills.values())), {"recipe": self.recipe}

    def __deepcopy__(self, memo: dict[int, object]) -> BiplaneFluoroscope:
        return self  # never changes

    @classmethod
    def of(
        cls,
        phantom: ImagedPhantom,
        geometry: str = "guide3d",
        *,
        size: int = 1024,
        surroundings: str | XRayScene = "bath",
        filling: str = "fluid",
        material: WireMaterial | None = None,
        catheter: WireMaterial | None = None,
    ) -> BiplaneFluoroscope:
        """The fluoroscope of a phantom; what does not depend on the wire is computed once a process.

        Args:
            geometry: "guide3d" (the public data set's) or "clinical" (frontal and lateral).
            size: px, side of the square images, 16 to 4,096.
            surroundings: "bath", "patient", "empty", or an `XRayScene`.
            filling: of the lumen, "fluid", "contrast" or "air"; an `XRayScene` brings its own.
            material: of the wire; by default nitinol in a tungsten-filled jacket.
            catheter: material of a catheter, as `catheter_material` makes it.

        Raises:
            ValueError: for an unknown geometry, scene, filling or an impossible size.
        """
        if geometry not in PAIRS:
            raise ValueError(f"unknown geometry {geometry!r}: expected one of {', '.join(PAIRS)}.")
        if not 16 <= size <= MAXIMUM_SIZE:
            raise ValueError(f"images need 16 to {MAXIMUM_SIZE} px a side, got {size!r}.")
        what = scene(surroundings, filling) if isinstance(surroundings, str) else surroundings
        centre = phantom.bounds.mean(axis=0)
        made = cls.over(phantom, PAIRS[geometry](centre, size), what, material)
        made.recipe = {"phantom": phantom, "geometry": geometry, "size": size, "surroundings": surroundings}
        made.recipe |= {"filling": filling, "material": material}
        return made if catheter is None else made.with_catheter(catheter)

    def with_catheter(self, catheter: WireMaterial) -> BiplaneFluoroscope:
        """The same fluoroscope, which draws a catheter of a material, too."""
        cameras, stills = tuple(self.cameras.values()), tuple(self._stills.values())
        made = type(self)(cameras, stills, material=self.material, catheter=catheter, centre=self._centre)
        made.recipe = None if self.recipe is None else {**self.recipe, "catheter": catheter}
        return made

    @classmethod
    def over(
        cls,
        phantom: ImagedPhantom,
        cameras: Sequence[XRayCamera],
        what: XRayScene,
        material: WireMaterial | None = None,
    ) -> BiplaneFluoroscope:
        """The fluoroscope of cameras over a phantom in its surroundings, for wires about its middle."""
        stills = [radiograph(phantom.grid, camera, what, key=phantom.hash) for camera in cameras]
        return cls(cameras, stills, material=material, centre=phantom.bounds.mean(axis=0))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cameras."""
        return tuple(self.cameras)

    def render(
        self, points: ArrayLike, seed: int | np.random.Generator | None = None, *, only: Sequence[str] | None = None
    ) -> dict[str, Frame]:
        """Images and masks of a wire by camera, new arrays.

        Args:
            points: (n, 3) m, the wire's nodes from the tip, world frame; fewer than two draw nothing.
            seed: of the noise, or a generator to draw it from; None gives the expected image, without noise.
            only: names of the cameras wanted; all by default. The noise of a camera does not depend on it.

        Raises:
            ValueError: for points of another shape, not finite, or behind a source, or an unknown camera.
        """
        frames = {}
        for name, own in self._seeds(seed, only).items():
            shadow = self._shadows[name].shadow(points)
            image = self._image(name, shadow, own)
            frames[name] = Frame(image, _mask(shadow, image.shape))
        return frames

    def render_devices(
        self,
        wire: ArrayLike,
        catheter: ArrayLike,
        seed: int | np.random.Generator | None = None,
        *,
        only: Sequence[str] | None = None,
    ) -> dict[str, DevicesFrame]:
        """Images of a wire and a catheter by camera, with a mask of each device, new arrays.

        Args:
            wire, catheter: (n, 3) m, nodes of each from its tip, world frame; fewer than two draw nothing.
            seed, only: as of `render`.

        Raises:
            ValueError: as of `render`, or the fluoroscope has no catheter's material.
        """
        if self.catheter is None:
            raise ValueError("this fluoroscope was made without a catheter's material: make it by with_catheter().")
        _, tube = split(nodes_of(catheter), ROUND_END * self.catheter.radius)
        frames = {}
        for name, own in self._seeds(seed, only).items():
            inner, outer = self._shadows[name].shadow(wire), self._tubes[name].shadow(tube)
            both = overlaid(inner, outer)
            image = self._image(name, both, own)
            frames[name] = DevicesFrame(image, *(_mask(one, image.shape) for one in (both, inner, outer)))
        return frames

    def _seeds(self, seed: int | np.random.Generator | None, only: Sequence[str] | None) -> dict[str, int | None]:
        """A seed for each camera that is wanted."""
        unknown = [name for name in only or () if name not in self.cameras]
        if unknown:
            raise ValueError(f"unknown camera {unknown[0]!r}: there are {', '.join(self.cameras)}.")
        generator = np.random.default_rng(seed) if isinstance(seed, int | np.integer) else seed
        seeds: list[int | None] = [None] * len(self.cameras)
        if generator is not None:
            seeds = generator.integers(0, 2**64, len(self.cameras), dtype=np.uint64).tolist()
        return {name: own for name, own in zip(self.cameras, seeds, strict=True) if only is None or name in only}

    def _image(self, name: str, shadow: ShadowWindow | None, seed: int | None) -> NDArray[np.uint8]:
        camera, still, kernel = self.cameras[name], self._stills[name], self._kernels[name]
        projector, detector = camera.projector, camera.detector
        width, height = projector.width, projector.height
        image = np.empty((height, width), np.uint8)
        window: tuple[Any, ...] = (0, 0, 0, 0, None)
        if shadow is not None:
            high, wide = shadow.mask.shape
            window = (shadow.left, shadow.top, wide, high, shadow.transmission.ctypes.data)
        exposure = _ExposureStruct(
            *(width, height, still.primary.ctypes.data, still.veil.ctypes.data),
            *window,
            detector.white(width, height),
            detector.video(width, height) if seed is not None else 0.0,
            int(seed is not None),
            len(kernel) - 1,
            kernel.ctypes.data,
            _normal_quantiles().ctypes.data,
        )
        if self._expose(ctypes.addressof(exposure), seed or 0, image.ctypes.data):
            raise ValueError(f"camera {name}'s image or blur is too large: at most {MAXIMUM_SIZE} px and 16 px.")
        return image

    def centreline(self, points: ArrayLike, name: str) -> NDArray[np.float64]:
        """The wire's smooth axis as a camera shows it: what its image and mask are drawn along.

        Args:
            points: (n, 3) m, the wire's nodes from the tip, world frame.

        Returns:
            (m, 2) px from the tip, distorted, about 1.5 px apart; points may lie outside the image.
        """
        return self._shadows[name].centreline(points)[0]

    def to_json(self) -> dict[str, Any]:
        """Every camera's matrices and distortion as plain JSON values."""
        return {name: camera.to_json() for name, camera in self.cameras.items()}


def _mask(shadow: ShadowWindow | None, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    return np.zeros(shape, np.uint8) if shadow is None else shadow.whole_mask((shape[0], shape[1]))


def _kernel(camera: XRayCamera) -> NDArray[np.float32]:
    """Half of the screen's blur, centre first."""
    detector = camera.detector
    spread = detector.screen_blur * detector.scale(camera.projector.width, camera.projector.height)
    half = np.arange(np.ceil(3.5 * spread) + 1)
    weights = np.exp(-0.5 * np.square(half / max(spread, 1e-3)))
    return np.ascontiguousarray(weights / (2 * weights.sum() - 1), dtype=np.float32)


@functools.cache
def _normal_quantiles() -> NDArray[np.float32]:
    from scipy.special import ndtri  # here, as only bi-planar views need it

    quantiles = ndtri((np.arange(_NORMALS) + 0.5) / _NORMALS)
    return np.ascontiguousarray(quantiles / quantiles.std(), dtype=np.float32)


@functools.cache
def _native_expose() -> Any:
    from cathsim.contact.native import library

    expose = library().cathsim_expose
    expose.argtypes = [ctypes.c_void_p, ctypes.c_uint64, ctypes.c_void_p]
    expose.restype = ctypes.c_int
    return expose
