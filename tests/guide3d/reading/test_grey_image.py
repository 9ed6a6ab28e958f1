"""Images as readers take them: depth, colour, size, contrast, and the rim that was not exposed."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.reading.grey_image import grey_image

RNG = np.random.default_rng(0)
GREY = RNG.integers(20, 220, (256, 300), dtype=np.uint8)


def test_bytes_stay_as_they_are() -> None:
    grey = grey_image(GREY)
    assert np.array_equal(grey.pixels, GREY)
    assert grey.scale == 1.0
    assert not grey.outside.any()
    assert not grey.messages


@pytest.mark.parametrize("factor", [16, 257, 1.0 / 255.0, 1e-3])
def test_other_depths_are_brought_to_bytes(factor: float) -> None:
    deep = (GREY.astype(float) * factor).astype(np.uint16 if factor > 1 else np.float64)
    grey = grey_image(deep)
    assert grey.pixels.dtype == np.uint8
    assert np.corrcoef(grey.pixels.ravel(), GREY.ravel())[0, 1] > 0.999
    assert "taken to 8 bits" in grey.messages[0]


def test_saturated_pixels_and_a_pedestal_leave_the_contrast() -> None:
    deep = 16 * GREY.astype(np.uint16) + 20_000
    deep[:, :8] = 65_535  # 2.7 %
    pixels = grey_image(deep).pixels
    assert np.ptp(pixels[:, 8:].astype(float)) > 140
    assert pixels[:, :8].min() == 255
    plain = grey_image(deep[:, 8:] - 20_000).pixels.astype(float)
    assert np.abs(grey_image(deep - 20_000).pixels[:, 8:] - plain).max() <= 2


def test_channels_that_agree_are_grey_and_a_photograph_is_refused() -> None:
    assert np.array_equal(grey_image(np.repeat(GREY[..., None], 3, axis=2)).pixels, GREY)
    photograph = RNG.integers(0, 255, (256, 256, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match=r"expected a grey X-ray image, got a picture of which \d+% is coloured"):
        grey_image(photograph)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((256, 256), np.uint8), "no contrast"),
        (np.full((256, 256), 0.5), "no contrast"),
        (RNG.integers(0, 255, (64, 64), dtype=np.uint8), "at least 128 x 128 px, got 64 x 64"),
        (np.zeros(10), "expected a grey image"),
        (np.zeros((200, 200), bool), "expected a grey image"),
        (np.where(RNG.random((200, 200)) < 0.01, np.nan, 1.0), "finite"),
        (GREY * 1e300, "finite grey values of at most 1e[+]30"),
        (np.repeat(GREY[..., None], 3, axis=2) * 1e305, "finite grey values of at most 1e[+]30"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        grey_image(image)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("side", "shape"), [(1024, (1024, 901)), (512, (512, 451)), (2049, (2049, 1803))])
def test_images_are_resampled_and_points_go_both_ways(side: int, shape: tuple[int, int]) -> None:
    grey = grey_image(RNG.integers(0, 255, (2049, 1803), dtype=np.uint8)).resampled(side)
    assert grey.pixels.shape == grey.outside.shape == shape
    points = RNG.uniform(0, 900, (5, 2))
    assert np.allclose(grey.from_given(grey.to_given(points)), points)
    corners = np.array([[-0.5, -0.5], [shape[1] - 0.5, shape[0] - 0.5]])  # the border of the image stays its border
    assert np.allclose(grey.to_given(corners), [[-0.5, -0.5], [1802.5, 2048.5]])


def test_the_black_rim_is_not_exposed() -> None:
    y, x = np.mgrid[:512, :512]
    field = np.hypot(x - 256, y - 256) < 250
    image = np.where(field, 120 + RNG.integers(0, 20, (512, 512)), 2).astype(np.uint8)
    outside = grey_image(image).outside
    assert outside[5, 5]
    assert not outside[256, 256]
    assert (outside != ~field).mean() < 0.03


def test_a_strip_is_not_made_thinner_than_a_wire_needs() -> None:
    strip = RNG.integers(0, 255, (3000, 140), dtype=np.uint8)
    assert [one.pixels.shape for one in grey_image(strip).at_known_scales()] == [(2743, 128)]
    assert [one.pixels.shape for one in grey_image(strip[:2000].repeat(3, 1)).at_known_scales()] == [(1024, 215)]
