"""One drawn X-ray image, resampled, is read alike by the shipped reader."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d import read
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from tests.guide3d.reading.drawn_maps import within
from tests.guide3d.reading.test_curve_reading import ARCH


@pytest.mark.parametrize(("side_px", "read_px"), [(256, 1024), (512, 512), (1024, 1024), (1536, 1024), (3072, 1024)])
def test_one_image_of_any_size_is_read_alike(side_px: int, read_px: int) -> None:
    width_px = 3.0
    plain = FluoroscopySettings(
        narrowest_px=width_px, widest_px=width_px, weakest=0.7, no_wire=0, two_devices=0, catheter=0, along_edge=0,
        in_vessel=0, tip_change=0, beads=0, markers=0, clutter=1e-6, contrast=0, noise=2, field=0, jpeg=0,
    )  # fmt: skip
    drawn = RandomFluoroscopy(plain, seed=3).along(0, [ARCH])
    way = cv2.INTER_AREA if side_px < 1024 else cv2.INTER_CUBIC
    reading = read(cv2.resize(drawn.image, (side_px, side_px), interpolation=way))
    points = (reading.points_px + 0.5) * 1024 / side_px - 0.5
    assert within(points, np.concatenate(drawn.wires[0])) > 0.95
    said = f"the image of {side_px} x {side_px} px was read at {read_px} x {read_px} px"
    assert (said in reading.notes) == (read_px != side_px) or side_px < 512  # read at both sizes
