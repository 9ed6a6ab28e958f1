"""Filters against SciPy's, which look at the mirrored image beyond the border, too."""

import numpy as np
import pytest
from scipy import ndimage

from guide3d.image_filters import (
    sampled,
)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 255, (61, 83))


@pytest.mark.parametrize("shape", [(), (0,), (7,), (1024,), (3000,), (40, 50, 3)])
@pytest.mark.parametrize("outside", [None, 0.0])
def test_values_between_pixels(shape: tuple[int, ...], outside: float | None, image: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 82, shape), rng.uniform(0, 60, shape)
    expected = ndimage.map_coordinates(image, [y.ravel(), x.ravel()], order=1).reshape(shape)
    values = sampled(image, x, y, outside)
    assert values.shape == shape
    assert np.abs(values - expected).max(initial=0.0) < 0.01  # places are float32
    far = sampled(image, np.array([-9.0, 200.0]), np.array([30.0, 30.0]), outside)
    assert far == pytest.approx([image[30, 0], image[30, -1]] if outside is None else [0.0, 0.0], rel=1e-6)


def test_more_places_than_opencv_takes_at_once(image: np.ndarray) -> None:
    count = 17 * 1024 * 1024
    x = np.resize(np.linspace(0, 82, 999, dtype=np.float32), count)
    values = sampled(image, x, np.full(count, 7.0, np.float32))
    assert np.array_equal(values[:999], sampled(image, x[:999], np.full(999, 7.0)))
    assert np.array_equal(values[-999:], values[:count][-999:])
    assert np.isclose(values[-1], np.interp(x[-1], np.arange(83), image[7]), atol=0.01)
