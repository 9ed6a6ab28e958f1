"""X-ray images for people: both C-arms, in a patient's CT, with the contrast of a display and the devices drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.devices.simulation import DEVICE_NAMES
from cathsim.fluoroscopy import XRayScene
from cathsim.observations.fluoroscopes import catheter_in, frame_of, shown_points, wire_radius_of
from cathsim.observations.framing import framed
from cathsim.observations.xray import contrast_run, fluoroscope_of
from cathsim.presets import WIRE_RADIUS
from cathsim.simulation import Simulation
from cathsim.viewing.opencv import cv2

VIEWS = ("frontal", "lateral")
WIRE, CATHETER = (255, 214, 10), (120, 200, 255)  # red, green, blue
_SHIFT = 4  # bits of cv2's fixed-point places
_WINDOW, _LIGHTEST = (2, 98), 235.0  # percentiles of a first image's grey levels, shown as 0 and as this


class DisplayWindow:
    """Spreads the grey levels of X-ray images over those of a display, all of a view as its first image."""

    def __init__(self) -> None:
        self._levels: dict[str, tuple[float, float]] = {}

    def shown(self, image: NDArray[np.uint8], view: str) -> NDArray[np.uint8]:
        """An image of a view, of the same shape."""
        if view not in self._levels:
            inside = image[(image > 0) & (image < 255)]
            low, high = np.percentile(inside, _WINDOW).tolist() if inside.size else (0.0, 255.0)
            self._levels[view] = low, max(high - low, 1.0)
        low, width = self._levels[view]
        return np.clip((image - low) * (_LIGHTEST / width), 0, 255).astype(np.uint8)


class DisplayFluoroscope:
    """Noisy X-ray images of a simulation, of each view, beside each other.

    The devices, whose shadows are faint in a patient, are drawn: the catheter as a broad line, the wire over it.

    Args:
        size: side of a view's image, px.
        background: X-ray background of the vessels, such as of `cathsim.fluoroscopy.ct_scene`.
    """

    def __init__(self, simulation: Simulation, size: int, background: XRayScene) -> None:
        self._simulation, self._generator, self._window = simulation, np.random.default_rng(0), DisplayWindow()
        phantom, radius, self._catheter = simulation.phantom, wire_radius_of(simulation), catheter_in(simulation)
        self._seen = {
            view: (
                fluoroscope_of(phantom, size, radius, self._catheter, view, background=background),
                framed(phantom, view, size),
            )
            for view in VIEWS
        }

    def image(self) -> NDArray[np.uint8]:
        """The images of the moment. Shape (size, views * size, 3)."""
        return np.concatenate([self._view(view) for view in self._seen], axis=1)

    def _view(self, view: str) -> NDArray[np.uint8]:
        fluoroscope, projector = self._seen[view]
        grey = frame_of(self._simulation, fluoroscope, self._generator, view).image
        panel = np.repeat(self._window.shown(grey, view)[:, :, None], 3, axis=2)
        wire, catheter = DEVICE_NAMES
        drawn = [(None, WIRE, 1)] if self._catheter is None else [(catheter, CATHETER, 3), (wire, WIRE, 1)]
        for device, colour, width in drawn:
            points = shown_points(self._simulation, device)
            places = np.rint(projector.project(points) * 2**_SHIFT).astype(np.int32)
            cv2.polylines(panel, [places[:, None]], False, colour, width, cv2.LINE_AA, _SHIFT)
        return panel


def contrast_picture(
    phantom: Phantom, size: int, background: XRayScene, views: Sequence[str] = VIEWS
) -> NDArray[np.uint8]:
    """The vessels full of contrast medium over an X-ray background, no device in them. Shape (size, views * size).

    Args:
        size: side of a view's image, px.
    """
    window = DisplayWindow()
    runs = [contrast_run(phantom, size, WIRE_RADIUS, view=view, background=background) for view in views]
    images = [window.shown(run.contrast[0], view) for run, view in zip(runs, views, strict=True)]
    return np.concatenate(images, axis=1)
