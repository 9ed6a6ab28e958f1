"""Filters against SciPy's, which look at the mirrored image beyond the border, too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from guide3d.image_filters import (
    blurred,
    closed,
    laplacian,
    largest_around,
    least_around,
    mean_around,
    sampled,
    white_tophat,
)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 255, (61, 83))


@pytest.mark.parametrize("sigma", [0.7, 2.3, 9.0])
def test_gaussians(sigma: float, image: np.ndarray) -> None:
    assert np.abs(blurred(image, sigma) - ndimage.gaussian_filter(image, sigma)).max() < 1e-10
    assert np.abs(laplacian(image, sigma) - ndimage.gaussian_laplace(image, sigma)).max() < 1e-10
    assert blurred(image.astype(np.float32), sigma).dtype == np.float32


def test_the_laplacian_of_a_hill_is_known() -> None:
    y, x = np.mgrid[-40:41, -40:41]
    hill = np.exp(-(x**2 + y**2) / (2 * 6.0**2))
    assert laplacian(hill, 3.0)[40, 40] == pytest.approx(-2 * 6.0**2 / (6.0**2 + 3.0**2) ** 2, rel=0.01)


@pytest.mark.parametrize("side", [3, 9, 25])
def test_morphology(side: int, image: np.ndarray) -> None:
    assert np.array_equal(largest_around(image, side), ndimage.maximum_filter(image, side))
    assert np.array_equal(least_around(image, side), ndimage.minimum_filter(image, side))
    assert np.array_equal(closed(image, side), ndimage.grey_closing(image, side))
    assert np.array_equal(closed(image.astype(np.uint8), side), ndimage.grey_closing(image.astype(np.uint8), side))


@pytest.mark.parametrize("side", [2, 5, 10, 11])
def test_white_tophats_of_odd_and_even_squares(side: int, image: np.ndarray) -> None:
    assert np.abs(white_tophat(image, side) - ndimage.white_tophat(image, size=side)).max() < 1e-12


def test_means_keep_the_border_and_round(image: np.ndarray) -> None:
    means = ndimage.uniform_filter(image, 5, mode="nearest")
    assert np.abs(mean_around(image, 5) - means).max() < 1e-10
    whole = image.astype(np.uint8)
    exact = ndimage.uniform_filter(whole.astype(float), 5, mode="nearest")
    assert np.abs(mean_around(whole, 5) - exact).max() <= 0.5 + 1e-9


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
