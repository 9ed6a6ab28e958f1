"""Clutter of guide3d's random fluoroscopy for cathsim's X-ray images: tubes, plates, marks and bones in the way."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pipeline.store.errors import ConfigurationError

if TYPE_CHECKING:
    from cathsim.observations.xray import Clutter, DrawClutter
    from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy

_INDICES = 2**31
_LARGEST_PX = 1024  # of the images of random fluoroscopy


def require_clutter_fits(image_size_px: int, setting: str) -> None:
    """Refuses images, as of a setting, that are larger than those of random fluoroscopy, whose clutter they get."""
    if image_size_px > _LARGEST_PX:
        raise ConfigurationError(
            f"clutter is drawn in images of at most {_LARGEST_PX} px, got {setting}={image_size_px}: make them "
            "smaller, or give stage.clutter=0"
        )


def clutter_of(amount: float) -> DrawClutter | None:
    """Draws an episode's clutter: `amount` times as much as in the images that networks learn from; None for 0."""
    if not amount:
        return None
    from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
    from guide3d.random_fluoroscopy.settings import FluoroscopySettings

    # the vessels full of contrast medium are the simulator's
    return partial(_draw, RandomFluoroscopy(FluoroscopySettings(clutter=amount, contrast=0.0)))


def _draw(fluoroscopy: RandomFluoroscopy, generator: np.random.Generator, size: int) -> Clutter:
    return fluoroscopy.clutter(int(generator.integers(_INDICES)), size)
