"""The picture of a moment: the image at the left, mark and predicted tip at the right."""

from __future__ import annotations

import numpy as np

from splineformer.navigation.picture import SIDE_PX, picture_of_moment
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.drawn_moments import perception_network


def near(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of the right half's pixels of a colour."""
    return np.argwhere((picture[:, SIDE_PX:] == colour).all(axis=2))


def test_mark_and_tip_are_drawn_where_they_are() -> None:
    network, image = perception_network(), image_of(wavy_wire(0))
    picture = picture_of_moment(image, network, (0.25, 0.75))
    assert picture.shape == (SIDE_PX, 2 * SIDE_PX, 3)
    left = picture[:, :SIDE_PX].astype(int)
    assert (left == left[..., :1]).all()  # grey
    assert np.abs(left[..., 0] - image).mean() < 3
    mark = near(picture, (0, 190, 255))
    np.testing.assert_allclose(mark.mean(axis=0), (0.75 * SIDE_PX, 0.25 * SIDE_PX), atol=2)
    tip = near(picture, (60, 255, 60))
    x, y = SIDE_PX * network([image])[0].points[0]
    np.testing.assert_allclose(tip.mean(axis=0), (y, x), atol=3)
