"""Fluoroscopes that look at a simulation: the simple frontal one and bi-planar C-arms, of one device or of two."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Interval

from cathsim.anatomy import Phantom
from cathsim.contact.sdf import Vessel
from cathsim.devices.catheter import Catheter
from cathsim.devices.simulation import DEVICE_NAMES, DualSimulation
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import MAXIMUM_SIZE, WIRE_RADIUS
from cathsim.simulation import Simulation
from cathsim.validation import Unit, quantity

if TYPE_CHECKING:
    from cathsim.fluoroscopy import (
        BiplaneFluoroscope,
        DeviceRenderer,
        DevicesFrame,
        FluoroscopyRenderer,
        Frame,
        WireMaterial,
    )

_ImageSize = Annotated[int, Interval(ge=16, le=MAXIMUM_SIZE), Unit("px")]
FRAMES = 3  # of the sequential observation
SHOWN_SHEATH = 0.010  # this much of a device inside the sheath is drawn, m
BEHIND = 0.12  # so much of a device behind the entry is drawn in bi-planar images: to their border, m
BEHIND_STEP = 0.005


@kept_with_owner
def camera(phantom: Phantom, size: int, wire_radius: float) -> FluoroscopyRenderer:
    """The frontal fluoroscope of a phantom, shared by every environment that looks at it."""
    from cathsim.fluoroscopy import FluoroscopyRenderer, Projector, background_image

    projector = Projector.frontal(phantom.bounds, size)
    background = background_image(phantom.grid, projector, key=phantom.hash)
    centre = phantom.bounds.mean(axis=0)
    return FluoroscopyRenderer(projector, background, wire_radius=wire_radius, centre=centre)


@kept_with_owner
def camera_of_devices(phantom: Phantom, size: int, wire_radius: float, catheter: Catheter) -> DeviceRenderer:
    """The frontal fluoroscope of a phantom for a wire in a catheter, shared as `camera` is."""
    from cathsim.fluoroscopy import DeviceRenderer, Projector, background_image

    projector = Projector.frontal(phantom.bounds, size)
    background = background_image(phantom.grid, projector, key=phantom.hash)
    centre, material = phantom.bounds.mean(axis=0), material_of(catheter)
    return DeviceRenderer(projector, background, wire_radius=wire_radius, catheter=material, centre=centre)


def material_of(catheter: Catheter) -> WireMaterial:
    """A catheter under X-rays, its lumen full of saline where no wire is."""
    from cathsim.fluoroscopy import catheter_material

    return catheter_material(
        catheter.radius,
        catheter.inner_diameter / 2,
        wall=catheter.wall_attenuation,
        marker=catheter.marker_attenuation,
        marker_length=catheter.marker_length,
    )


def catheter_in(simulation: Simulation) -> Catheter | None:
    """The catheter of a simulation; None of a bare wire."""
    return simulation.pair.catheter if isinstance(simulation, DualSimulation) else None


def wire_radius_of(simulation: Simulation) -> float:
    """Radius of a simulation's wire, m; of a catheter alone the default wire's, which is not drawn."""
    if not isinstance(simulation, DualSimulation):
        return simulation.wire.radius
    return simulation.pair.wire.radius if simulation.pair.wire else WIRE_RADIUS


class Fluoroscope:
    """Frontal image and masks of a simulation, drawn once a step at most."""

    def __init__(self, simulation: Simulation, size: int) -> None:
        size = quantity("image_size", size, _ImageSize)
        self.simulation = simulation
        self.shape = (size, size)
        self._image, self._mask = np.empty(self.shape, np.uint8), np.empty(self.shape, np.uint8)
        # the wire's, and the catheter's
        self._masks = {} if catheter_in(simulation) is None else {one: self._mask.copy() for one in DEVICE_NAMES}
        self._drawn = self._kept = False
        self.frames: list[np.ndarray] = []

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "renderer"}

    @cached_property
    def renderer(self) -> FluoroscopyRenderer | DeviceRenderer:
        """The camera, made at the first look: its background costs time and memory."""
        phantom, radius = self.simulation.phantom, wire_radius_of(self.simulation)
        catheter = catheter_in(self.simulation)
        if catheter is None:
            return camera(phantom, self.shape[0], radius)
        return camera_of_devices(phantom, self.shape[0], radius, catheter)

    def update(self, *, restart: bool = False) -> None:
        """Says that the simulation has moved on (or restarted): the next look draws again."""
        self._drawn = self._kept = False
        if restart:
            self.frames = []

    def state(self) -> tuple[bool, list[np.ndarray]]:
        """The images kept for `sequence`, for `restore`."""
        return self._kept, list(self.frames)

    def restore(self, state: tuple[bool, list[np.ndarray]]) -> None:
        """Returns to kept images; the simulation has been restored before."""
        self._drawn = False
        self._kept, self.frames = state[0], list(state[1])

    def _draw(self) -> None:
        if self._drawn:
            return
        renderer: Any = self.renderer
        if not self._masks:
            renderer.render_into(shown_points(self.simulation), self._image, self._mask)
        else:
            wire, catheter = (shown_points(self.simulation, device) for device in DEVICE_NAMES)
            wire_mask, catheter_mask = (self._masks[device] for device in DEVICE_NAMES)
            renderer.render_into(wire, catheter, self._image, wire_mask, catheter_mask)
            np.bitwise_or(wire_mask, catheter_mask, out=self._mask)
        self._drawn = True

    def image(self) -> np.ndarray:
        """Grey image, devices dark. Shape (size, size), uint8, a copy."""
        self._draw()
        return self._image.copy()

    def mask(self, device: str | None = None) -> np.ndarray:
        """A device's pixels, 0 or 1; None: of both. Shape (size, size), uint8, a copy.

        Raises:
            ValueError: the mask of a catheter is asked for, and there is none.
        """
        device = shown_device(self.simulation, device)
        self._draw()
        return (self._mask if device is None else self._masks[device]).copy()

    def sequence(self) -> np.ndarray:
        """The last three images, oldest first; the first image of an episode stands for the missing ones."""
        if not self._kept:  # a second look in the same step is no new frame
            latest = self.image()
            self.frames = [*self.frames[1:], latest] if self.frames else [latest] * FRAMES
            self._kept = True
        return np.stack(self.frames)


class BiplaneView:
    """Bi-planar images and masks of a simulation, each drawn once a step at most.

    Args:
        fluoroscope: draws the simulation's catheter of its own material, unless it has been given one.
    """

    def __init__(self, simulation: Simulation, fluoroscope: BiplaneFluoroscope) -> None:
        catheter = catheter_in(simulation)
        if catheter is not None and fluoroscope.catheter is None:
            fluoroscope = fluoroscope.with_catheter(material_of(catheter))
        self.simulation, self.fluoroscope = simulation, fluoroscope
        self._seed, self._moment = 0, 0
        self._frames: dict[str, Frame | DevicesFrame] = {}

    def update(self, *, seed: int | None = None) -> None:
        """Says that the simulation has moved on, or restarted with a seed of the episode's noise."""
        self._frames = {}
        self._moment += 1
        if seed is not None:
            self._seed, self._moment = seed, 0

    def state(self) -> tuple[int, int]:
        """Seed and moment of the noise, for `restore`."""
        return self._seed, self._moment

    def restore(self, state: tuple[int, int]) -> None:
        """Returns to a moment; the simulation has been restored before."""
        self._frames = {}
        self._seed, self._moment = state

    def frame(self, name: str) -> Frame | DevicesFrame:
        """Image and mask of a camera, with a catheter also each device's mask; not to be written into."""
        if name not in self._frames:
            # the noise of a moment depends on seed and step alone, not on which camera was looked at before
            generator = np.random.default_rng((self._seed, self._moment))
            self._frames[name] = frame_of(self.simulation, self.fluoroscope, generator, name)
        return self._frames[name]

    def mask(self, name: str, device: str | None = None) -> np.ndarray:
        """A device's pixels in a camera's image, 0 or 1; None: of both; not to be written into."""
        device = shown_device(self.simulation, device)
        frame = self.frame(name)
        return frame.mask if device is None else getattr(frame, f"mask_{device}")


def frame_of(
    simulation: Simulation, fluoroscope: BiplaneFluoroscope, generator: np.random.Generator, name: str
) -> Frame | DevicesFrame:
    """What a camera of a fluoroscope, which has the simulation's devices' materials, shows of a simulation."""
    if catheter_in(simulation) is None:
        return fluoroscope.render(points_to_border(simulation), generator, only=(name,))[name]
    wire, catheter = (points_to_border(simulation, device) for device in DEVICE_NAMES)
    return fluoroscope.render_devices(wire, catheter, generator, only=(name,))[name]


def shown_device(simulation: Simulation, device: str | None) -> str | None:
    """Whose mask is meant: None (both devices), or "wire" or "catheter" where there are two.

    Raises:
        ValueError: the mask of a catheter is asked for, and there is none.
    """
    if catheter_in(simulation) is not None:
        return device
    if device == "catheter":
        raise ValueError("the mask of a catheter needs a catheter: pass catheter='vertebral' or another")
    return None


def points_to_border(simulation: Simulation, device: str | None = None) -> np.ndarray:
    """Nodes from the tip through the sheath, on to where the device has left every image, m. Shape (n, 3).

    Args:
        device: "wire" or "catheter" of two; None: the bare wire. An absent one has no nodes.
    """
    vessel = simulation.vessel
    points = _nodes(simulation, device)
    if not len(points):
        return points
    behind = float((vessel.entry - points[-1]) @ vessel.direction)
    steps = np.arange(BEHIND_STEP, max(BEHIND - behind, 0.0) + BEHIND_STEP, BEHIND_STEP)
    return np.concatenate((points, points[-1] - steps[:, None] * vessel.direction))


def shown_points(simulation: Simulation, device: str | None = None) -> np.ndarray:
    """Nodes that the frontal fluoroscope sees: from the tip to just inside the sheath, m. Shape (n, 3).

    Args:
        device: as of `points_to_border`.
    """
    return outside_sheath(_nodes(simulation, device), simulation.vessel)


def _nodes(simulation: Simulation, device: str | None) -> np.ndarray:
    if device is None:
        return simulation.inserted_points()
    assert isinstance(simulation, DualSimulation)
    return simulation.device_points(device)


def outside_sheath(points: np.ndarray, vessel: Vessel) -> np.ndarray:
    """Drops the nodes (k, 3) m, from the tip on, that lie deep inside the sheath, and closes the device there."""
    end = vessel.entry - SHOWN_SHEATH * vessel.direction
    visible_nodes = np.flatnonzero(points @ vessel.direction > end @ vessel.direction)
    # the nodes in the sheath are the last ones; others behind its end lie where the vessel has turned back
    return np.concatenate((points[: visible_nodes[-1] + 1 if len(visible_nodes) else 0], end[None]))
