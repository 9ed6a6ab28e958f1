"""The operator's X-ray pictures: what a C-arm sees, as JPEG."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from cathsim.fluoroscopy import DeviceRenderer, FluoroscopyRenderer, Projector
from cathsim.fluoroscopy.attenuation import CONTRAST, GAMMA, Keyed, expose, lumen_path_length
from cathsim.fluoroscopy.scene import THORAX, body_depth
from cathsim.navigation import NavigationTask
from cathsim.observations.fluoroscopes import catheter_in, material_of, outside_sheath, wire_radius_of
from cathsim.simulation import Simulation
from cathsim.validation import Unit, settings
from cathsim.viewing.opencv import cv2

IMAGE_SIZE = 480  # px
QUALITY = 88  # of the JPEG: 12 kB an image, no artefact to be seen beside the wire
ROADMAP = 0.7  # of the contrast medium's attenuation, by which the roadmap brightens the vessels


@settings
class CArm:
    """A view of a C-arm about the middle of the phantom."""

    primary_deg: Annotated[float, Interval(ge=-120, le=120), Unit("degrees")] = 0.0  # LAO positive, RAO negative
    secondary_deg: Annotated[float, Interval(ge=-50, le=50), Unit("degrees")] = 0.0  # cranial positive
    zoom: Annotated[float, Interval(ge=1, le=4)] = 1.0  # 1: the whole phantom in the frontal view


FIRST_VIEWS = {"a": CArm(), "b": CArm(primary_deg=90.0)}  # frontal and lateral


class FluoroscopyMonitor:
    """Draws the wire, or the wire in the catheter, in a C-arm's fluoroscopic image.

    The vessels are blood in soft tissue, so they are not seen before contrast medium fills them or the roadmap shows
    them.

    Args:
        simulation: whose phantom, sheath and devices are shown.
        view: of the C-arm.
        size: side of the image, px.
    """

    def __init__(self, simulation: Simulation, view: CArm | None = None, *, size: int = IMAGE_SIZE) -> None:
        self.size, self._vessel, self._phantom = size, simulation.vessel, simulation.phantom
        self.view = view or CArm()
        grid, bounds = simulation.phantom.grid, simulation.phantom.bounds
        projector, centre = _projector(bounds, self.view, size), bounds.mean(axis=0)
        middle = np.asarray(grid.origin) + (np.array(grid.blocks.shape) - 1) * grid.spacing / 2
        key = simulation.phantom.hash, projector.key
        background, self._contrast = _anatomy(Keyed(key, grid, projector, middle))
        catheter, radius = catheter_in(simulation), wire_radius_of(simulation)
        self._renderer: FluoroscopyRenderer | DeviceRenderer = (
            FluoroscopyRenderer(projector, background, wire_radius=radius, centre=centre)
            if catheter is None
            else DeviceRenderer(
                projector, background, wire_radius=radius, catheter=material_of(catheter), centre=centre
            )
        )
        self._image = np.empty((size, size), np.uint8)
        self._masks = np.empty((2, size, size), np.uint8)

    def image(
        self, wire: np.ndarray, catheter: np.ndarray | None = None, *, contrast: float = 0.0, roadmap: bool = False
    ) -> np.ndarray:
        """Grey levels (size, size) uint8.

        Args:
            wire: points of the wire from its tip on, m, world frame. Shape (n, 3).
            catheter: those of the catheter, (k, 3); needed where the simulation has one, and only there.
            contrast: medium in the lumen, 0 to 1; transmissions multiply.
            roadmap: lays the vessels over the image, brighter than their surroundings.
        """
        visible_wire = outside_sheath(wire, self._vessel)
        if isinstance(self._renderer, FluoroscopyRenderer):
            self._renderer.render_into(visible_wire, self._image, None)
        else:
            assert catheter is not None
            self._renderer.render_into(visible_wire, outside_sheath(catheter, self._vessel), self._image, *self._masks)
        share = (ROADMAP if roadmap else 0.0) - contrast
        if not share:
            return self._image
        return np.minimum(self._image * np.exp(share * self._contrast), 255.0).astype(np.uint8)

    def jpeg(
        self, wire: np.ndarray, catheter: np.ndarray | None = None, *, contrast: float = 0.0, roadmap: bool = False
    ) -> bytes:
        """The image of `image` as a grey JPEG."""
        image = self.image(wire, catheter, contrast=contrast, roadmap=roadmap)
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return data.tobytes()

    def mark(self, task: NavigationTask) -> dict[str, Any]:
        """Where the target lies in the image: `pixel` [u, v] and `radius` of the sphere of success, px."""
        projector = self._renderer.projector
        goal = task.goal(self._phantom)
        u, v = projector.project(goal[None])[0].tolist()
        return {"pixel": [u, v], "radius": task.success_radius * projector.pixels_per_metre(goal)}


@lru_cache(maxsize=16)
def _anatomy(request: Keyed) -> tuple[np.ndarray, np.ndarray]:
    """Grey levels of the body without contrast medium, and the exponent by which the full medium darkens them."""
    grid, projector, middle = request.arguments
    darker = (GAMMA * CONTRAST * lumen_path_length(grid, projector)).astype(np.float32)
    return expose(body_depth(projector, THORAX, middle)), darker


def _projector(bounds: np.ndarray, view: CArm, size: int) -> Projector:
    """The camera of a view, at zoom 1 with the scale of the frontal view that holds the whole phantom."""
    centre = bounds.mean(axis=0)
    field = size / Projector.frontal(bounds, size).pixels_per_metre(centre)
    return Projector.c_arm(
        centre=centre,
        field_of_view=field / view.zoom,
        size=size,
        primary_deg=view.primary_deg,
        secondary_deg=view.secondary_deg,
    )
