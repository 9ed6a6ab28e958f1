"""Centrelines of voxels: ends and ways of a tee, smoothing."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.centreline import LumenPaths, resampled, smoothed


def test_centrelines_of_a_tee():
    inside = np.zeros((60, 30, 90), dtype=bool)
    x, y, z = np.indices(inside.shape)
    inside |= ((x - 15) ** 2 + (y - 15) ** 2 <= 100) & (z >= 5) & (z < 85)
    inside |= ((z - 45) ** 2 + (y - 15) ** 2 <= 25) & (x >= 15) & (x < 58)
    paths = LumenPaths(inside, np.zeros(3), 1e-3)
    ends = paths.ends()
    assert len(ends) == 3
    assert sorted(int(end[2] > 45) + int(end[2] > 20) for end in ends) == [0, 1, 2]
    (way,) = paths.ways(ends[0], ends[1:2])
    assert (way[0] == ends[0]).all()
    assert (way[-1] == ends[1]).all()
    middle = way[(np.abs(way[:, 2] - 25) < 8)]
    assert np.abs(middle[:, :2] - 15).max() <= 2  # it keeps to the tube's axis


def test_smoothing_keeps_the_ends():
    arc = np.linspace(0, 0.1, 101)
    rough = np.stack([arc, 5e-4 * (-1) ** np.arange(101), 0 * arc], axis=1)
    calm = smoothed(rough, 3e-3)
    assert np.array_equal(calm[[0, -1]], rough[[0, -1]])
    assert np.abs(calm[10:-10, 1]).max() < 1e-4
    assert np.allclose(np.diff(resampled(rough[::100], 1e-3)[:, 0]), 1e-3)
