"""A wire and a catheter in the simple frontal image: the attenuation of both adds, and each has a mask."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.attenuation import GAMMA
from cathsim.fluoroscopy.curve import ROUND_END, split
from cathsim.fluoroscopy.materials import Section, WireMaterial, flat_marker, jacketed_wire
from cathsim.fluoroscopy.projector import Projector
from cathsim.fluoroscopy.renderer import (
    ENTRIES,
    FAILURES,
    MINIMUM_WIDTH_PX,
    WIRE_ATTENUATION,
    FluoroscopyRenderer,
    ViewStruct,
    mean_chord,
    native_draw,
    nodes_of,
    view_struct,
)
from cathsim.presets import WIRE_RADIUS

# The wire of the simple images attenuates 5.7 times as much as its materials at 60 keV do; so does the catheter there,
# which keeps the ratio of both.
EMPHASIS = float(WIRE_ATTENUATION * 2 * WIRE_RADIUS / jacketed_wire(WIRE_RADIUS).sections[-1].depth(0.0))


class DeviceRenderer:
    """Draws a catheter and a wire over one camera's background; deterministic, and safe to share between threads.

    Each device is drawn as `FluoroscopyRenderer` draws a wire. Transmissions multiply, to within half a grey level.

    Args:
        background: (height, width) grey levels 0 to 255 without devices.
        wire_radius: m; of any value where there is no wire.
        catheter: the catheter's material, as `catheter_material` makes it.
        centre: (3,) m, where widths are taken; the middle of the phantom.
    """

    def __init__(
        self,
        projector: Projector,
        background: ArrayLike,
        *,
        wire_radius: float = WIRE_RADIUS,
        catheter: WireMaterial,
        centre: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self._options: dict[str, Any] = {"wire_radius": wire_radius, "catheter": catheter, "centre": centre}
        self._bare = FluoroscopyRenderer(projector, background, wire_radius=wire_radius, centre=centre)
        self.projector, self.shape = projector, self._bare.shape
        self._grey = np.ascontiguousarray(background, dtype=np.float32)
        radius = max(catheter.radius * projector.pixels_per_metre(centre), MINIMUM_WIDTH_PX / 2)
        self._tables = [_tube_transmission(radius, section, GAMMA * EMPHASIS) for section in catheter.sections]
        self._views = [view_struct(projector, self._grey, table, radius) for table in self._tables]
        self._round = ROUND_END * catheter.radius
        self._marker_length = flat_marker(catheter).sections[0].length
        self._draw = native_draw()

    def __reduce__(self) -> tuple[Any, ...]:
        return functools.partial(type(self), **self._options), (self.projector, self._grey)

    def __deepcopy__(self, memo: dict[int, object]) -> DeviceRenderer:
        return self  # never changes

    @property
    def background(self) -> NDArray[np.uint8]:
        """(height, width) uint8, the image without devices, read-only."""
        return self._bare.background

    def render_into(
        self,
        wire: ArrayLike,
        catheter: ArrayLike,
        image_out: NDArray[np.uint8],
        wire_mask_out: NDArray[np.uint8],
        catheter_mask_out: NDArray[np.uint8],
    ) -> None:
        """Writes the image without noise and both masks into the caller's arrays.

        Args:
            wire, catheter: (n, 3) m, nodes of each in order from its tip, world frame; fewer than two draw nothing. A
                wire inside the catheter is in its mask, too: X-rays show it.
            image_out, wire_mask_out, catheter_mask_out: (height, width) uint8, C order.

        Raises:
            ValueError: for points of another shape, not finite, or behind the source, or outputs that do not fit.
        """
        inner, outer = (nodes_of(points) for points in (wire, catheter))
        self._bare.render_into(np.empty((0, 3)), image_out, catheter_mask_out)
        nearest = np.full(self.shape, np.inf, np.float32)
        _, shaft = split(outer, self._round)
        parts = [shaft] if len(self._views) == 1 else split(shaft, self._marker_length)
        for pattern, part in zip(self._views, parts, strict=True):
            view = ViewStruct.from_buffer_copy(pattern)
            view.nearest = nearest.ctypes.data
            self._draw_nodes(ctypes.addressof(view), part, image_out, catheter_mask_out)
        self._bare.render_over(image_out, inner, wire_mask_out)

    def _draw_nodes(
        self, view: int, nodes: NDArray[np.float64], image: NDArray[np.uint8], mask: NDArray[np.uint8]
    ) -> None:
        state = self._draw(view, len(nodes), nodes.ctypes.data, image.ctypes.data, mask.ctypes.data)
        if state:
            raise ValueError(FAILURES[state])


def _tube_transmission(radius_px: float, section: Section, emphasis: float) -> NDArray[np.float32]:
    """Grey level over background by squared distance from a section's axis, evenly over [0, (radius + 1/2)^2].

    The optical depth of nested cylinders is that of full ones, each of the difference to the material around it.
    """
    distance = np.sqrt(np.linspace(0.0, (radius_px + 0.5) ** 2, ENTRIES))
    depth, outside = np.zeros(ENTRIES), 0.0
    for radius, attenuation in reversed(section.layers):
        own = radius_px * radius / section.radius
        depth += (attenuation - outside) * 2 * radius * mean_chord(distance, own)
        outside = attenuation
    return np.exp(-emphasis * depth).astype(np.float32)
