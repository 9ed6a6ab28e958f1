"""Parts of a vessel that its smoothed wall has parted from the rest."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.volume.lumen.smoothing import ways_to_lost

SPACING = np.full(3, 1e-3)


def two_slabs(apart: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A vessel of two slabs of 6 x 3 voxels, one above the other's end, and the voxels of the first."""
    mask = np.zeros((60, 12, 12), dtype=bool)
    mask[2:30, 3:9, 2:5] = True
    kept = mask.copy()
    mask[29:55, 3:9, 5 + apart : 8 + apart] = True
    return mask, kept


def test_a_way_leads_over_the_step_to_the_far_end() -> None:
    mask, kept = two_slabs()
    (way,) = ways_to_lost(mask, kept, SPACING)
    voxels = np.rint(way / SPACING).astype(int)
    assert mask[tuple(voxels.T)].all()
    assert kept[tuple(voxels[0])]
    assert voxels[-1][0] == 54
    assert np.abs(np.diff(voxels, axis=0)).max() == 1


@pytest.mark.parametrize("case", ["all kept", "a few voxels", "a bar", "nothing touches"])
def test_no_way_where_nothing_is_lost_or_nothing_hangs_together(case: str) -> None:
    mask, kept = two_slabs(apart=2 if case == "nothing touches" else 0)
    if case == "all kept":
        kept = mask
    if case == "a bar":
        mask[29:, 3:9, 5:8] = False
        mask[25:55, 5, 5:7] = True
    if case == "a few voxels":
        kept = mask.copy()
        kept[54, 3:9, 5:8] = False
    assert ways_to_lost(mask, kept, SPACING) == []
