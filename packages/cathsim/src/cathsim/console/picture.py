"""The operator's pictures: the fluoroscopic image as JPEG, and what the page needs to draw the vessel in 3-D."""

from __future__ import annotations

from typing import Any

import numpy as np

from cathsim.anatomy import Phantom
from cathsim.anatomy.surface import lumen_surface
from cathsim.console.messages import surface_message
from cathsim.fluoroscopy import DeviceRenderer, FluoroscopyRenderer
from cathsim.navigation import NavigationTask
from cathsim.observations.fluoroscopes import (
    camera,
    camera_of_devices,
    catheter_in,
    outside_sheath,
    wire_radius_of,
)
from cathsim.opencv import cv2
from cathsim.simulation import Simulation

IMAGE_SIZE = 480  # px
QUALITY = 88  # of the JPEG: 12 kB an image, no artefact to be seen beside the wire
_STRIDE = 2  # grid nodes a node of the 3-D view's surface


class FluoroscopyMonitor:
    """Draws the wire, or the wire in the catheter, in the frontal fluoroscopic image.

    Args:
        simulation: whose phantom, sheath and devices are shown.
        size: side of the image, px.
    """

    def __init__(self, simulation: Simulation, *, size: int = IMAGE_SIZE) -> None:
        self.size, self._vessel, self._phantom = size, simulation.vessel, simulation.phantom
        catheter, radius = catheter_in(simulation), wire_radius_of(simulation)
        self._renderer: FluoroscopyRenderer | DeviceRenderer = (
            camera(simulation.phantom, size, radius)
            if catheter is None
            else camera_of_devices(simulation.phantom, size, radius, catheter)
        )
        self._image = np.empty((size, size), np.uint8)
        self._masks = np.empty((2, size, size), np.uint8)

    def jpeg(self, wire: np.ndarray, catheter: np.ndarray | None = None) -> bytes:
        """The image as a grey JPEG.

        Args:
            wire: points of the wire from its tip on, m, world frame. Shape (n, 3).
            catheter: those of the catheter, (k, 3); needed where the simulation has one, and only there.
        """
        shown = outside_sheath(wire, self._vessel)
        if isinstance(self._renderer, FluoroscopyRenderer):
            self._renderer.render_into(shown, self._image, None)
        else:
            assert catheter is not None
            self._renderer.render_into(shown, outside_sheath(catheter, self._vessel), self._image, *self._masks)
        _, data = cv2.imencode(".jpg", self._image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return data.tobytes()

    def mark(self, task: NavigationTask) -> dict[str, Any]:
        """Where the target lies in the image: `pixel` [u, v] and `radius` of the sphere of success, px."""
        projector = self._renderer.projector
        goal = task.goal(self._phantom)
        u, v = projector.project(goal[None])[0].tolist()
        return {"pixel": [u, v], "radius": task.success_radius * projector.pixels_per_metre(goal)}


def surface_of(phantom: Phantom) -> bytes:
    """The lumen's surface for the 3-D view, as a message."""
    mesh = lumen_surface(phantom.grid.coarser(_STRIDE))
    return surface_message(np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals), np.asarray(mesh.faces))
