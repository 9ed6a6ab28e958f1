"""Backgrounds from CT: what is dense is dark, at its place, from every side."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.random_fluoroscopy.anatomy import projected_ct


def phantom() -> np.ndarray:
    """A body of water with a bone and a bubble."""
    z, y, x = np.mgrid[:20, :60, :60]
    body = np.full((20, 60, 60), -1000.0)
    body[(x - 30) ** 2 + (y - 30) ** 2 < 25**2] = 0.0
    body[(x - 20) ** 2 + (y - 30) ** 2 < 16] = 1000.0
    body[(x - 40) ** 2 + (y - 30) ** 2 + (2 * (z - 10)) ** 2 < 36] = -1000.0
    return body


def test_bone_is_darker_and_gas_brighter() -> None:
    image = projected_ct(phantom(), (2.0, 1.0, 1.0), 0.0)
    assert image.shape[0] == 40
    middle = image[20]
    left = image.shape[1] // 2
    bone, gas = middle[left - 12 : left - 7].mean(), middle[left + 8 : left + 13].mean()
    assert bone > image[4][left + 8 : left + 13].mean() > gas  # where there is no gas, there is water


def test_from_the_side_bone_and_gas_lie_in_the_middle() -> None:
    image = projected_ct(phantom(), (2.0, 1.0, 1.0), 90.0)
    middle = image.shape[1] // 2
    assert image[4][middle - 2 : middle + 2].mean() > image[20][middle - 2 : middle + 2].mean()


def test_bad_volumes_are_refused() -> None:
    with pytest.raises(ValueError, match="expected a volume"):
        projected_ct(np.zeros((3, 3)), (1, 1, 1), 0)
    with pytest.raises(ValueError, match="spacing_mm"):
        projected_ct(np.zeros((3, 3, 3)), (1, 0, 1), 0)
