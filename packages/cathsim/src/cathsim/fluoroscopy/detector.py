"""What the detector adds to an image: the noise of a finite number of photons."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .attenuation import GAMMA


def quantum_noise(
    image: NDArray[np.uint8], photons: float, generator: np.random.Generator, *, gamma: float = GAMMA
) -> NDArray[np.uint8]:
    """An image as a detector that counts photons would have seen it.

    Args:
        image: (height, width) grey levels without noise.
        photons: mean count of a white pixel.
        generator: source of the draws.
        gamma: exponent of the display that the grey levels went through.

    Returns:
        (height, width) uint8.

    Raises:
        ValueError: for a count that is not positive.
    """
    if not photons > 0:
        raise ValueError(f"a noisy image needs a positive number of photons a pixel, got {photons!r}.")
    expected = photons * (image.astype(np.float64) / 255) ** (1 / gamma)
    counted = generator.poisson(expected)
    return np.clip(np.rint(255 * (counted / photons) ** gamma), 0, 255).astype(np.uint8)
