"""The detector: light over its field, blur, the noise of counted photons and of the display chain."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.validation import Listed, Share, Unit, settings

REFERENCE_SIZE = 1024  # px: lengths of a Detector are given for an image of this size

_Grey = Annotated[float, Interval(ge=0, le=255), Unit("grey levels")]
_Blur = Annotated[float, Interval(ge=0, le=200), Unit("px")]
_Side = Annotated[float, Interval(ge=-10, le=10), Unit("half image sides")]


@settings
class Detector:
    """An image intensifier or a panel; lengths in px of a 1024 px image, positions in half image sides from its middle.

    Its display shows the square root of the light, so that noise looks alike in dark and bright parts.
    """

    # mean count of a white pixel of a 1024 px image; larger pixels catch more
    photons: Annotated[float, Interval(gt=0, le=1e9), Unit("photons a pixel")] = 870.0
    # standard deviation of what the display chain adds to a 1024 px image, grey levels; larger pixels are means
    video_noise: _Grey = 1.7
    focal_blur: _Blur = 0.5  # standard deviation of the blur before the photons are counted, px: the focal spot's
    screen_blur: _Blur = 1.1  # that of the blur behind, which also smooths the noise, px
    glare: _Grey = 5.0  # grey level of the dark around the field
    # radius of the round collimator, half image sides; None for a panel without one
    field_radius: Annotated[float, Interval(gt=0, le=10), Unit("half image sides")] | None = 1.2
    field_centre: Annotated[tuple[_Side, _Side], Listed] = (0.0, 0.0)  # its middle, right and down
    penumbra: Annotated[float, Interval(ge=0, le=REFERENCE_SIZE), Unit("px")] = 30.0  # width of its soft border, px
    # distance from the field's middle, in its radii, at which the light has fallen to exp(-1/2)
    vignette: Annotated[float, Interval(gt=0, le=1000)] = 0.65
    # relative fall of the light from the left to the right side of the image, by the anode's heel
    heel: Annotated[float, Interval(gt=-1, lt=1)] = 0.0
    # how far slow differences of brightness are taken out, as beam-shaping filters do: 0 not at all
    equalisation: Share = 0.0

    def scale(self, width: int, height: int) -> float:
        """Pixels of an image for one of the reference size."""
        return min(width, height) / REFERENCE_SIZE

    def white(self, width: int, height: int) -> float:
        """Mean photon count of a white pixel of an image of some size."""
        return self.photons / self.scale(width, height) ** 2

    def video(self, width: int, height: int) -> float:
        """Standard deviation of what the display chain adds to an image of some size, grey levels."""
        return self.video_noise * min(self.scale(width, height), 1.0)

    def illumination(self, width: int, height: int) -> NDArray[np.float32]:
        """Light (height, width) on the detector without an object: 1 in the middle, 0 outside the collimator."""
        half = min(width, height) / 2
        x = (np.arange(width) - (width - 1) / 2) / half
        y = (np.arange(height) - (height - 1) / 2) / half
        light = np.broadcast_to(1 - self.heel * x / 2, (height, width))
        if self.field_radius is None:
            return light.astype(np.float32)
        r = np.hypot(*np.meshgrid(x - self.field_centre[0], y - self.field_centre[1])) / self.field_radius
        light = light * np.exp(-0.5 * np.square(r / self.vignette))
        width_share = max(self.penumbra * self.scale(width, height), 1.0) / (half * self.field_radius)
        shade = np.clip((1 - r) / width_share, 0.0, 1.0)  # how much of the source the collimator's edge lets through
        return (light * (1 - np.square(1 - shade))).astype(np.float32)
