"""Voxels that a resampling by whole numbers has repeated."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.volume.files.reading import LabelVolume
from cathsim.anatomy.volume.importer import join_repeated


def whole(vessels: np.ndarray, first: tuple[int, int, int], shape: tuple[int, int, int]) -> LabelVolume:
    affine = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    return LabelVolume(vessels, ("aorta",), affine, first, shape, np.eye(3), "a.nii", "mm", 1e-3, "names", True, ())


def test_repeated_voxels_are_one_again() -> None:
    before = np.random.default_rng(0).integers(1, 3, (12, 9, 11)).astype(np.uint8)
    fine = before.repeat(3, axis=0).repeat(2, axis=2)
    joined = join_repeated(whole(fine, (6, 1, 4), (60, 12, 30)))
    np.testing.assert_array_equal(joined.vessels, before)
    assert (joined.first, joined.shape) == ((2, 1, 2), (20, 12, 15))
    assert joined.affine @ [0, 0, 0, 1] == pytest.approx([1e-3, 0, 0.5e-3, 1])
    assert joined.spacing == pytest.approx([3e-3, 1e-3, 2e-3])
    assert "3 x 1 x 2 mm" in joined.notes[0]


@pytest.mark.parametrize("case", ["nothing repeats", "one slice more", "few slices"])
def test_other_voxels_stay(case: str) -> None:
    fine = np.random.default_rng(0).integers(1, 3, (12, 9, 11)).astype(np.uint8)
    if case == "one slice more":
        fine = np.concatenate([fine.repeat(2, axis=0), fine[-1:]])
    if case == "few slices":
        fine = fine[:4].repeat(2, axis=0)
    volume = whole(fine, (0, 0, 0), fine.shape)
    assert join_repeated(volume) is volume
