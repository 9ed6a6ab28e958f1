"""A CT of an imported phantom, which a person could have segmented it from."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest


def ct_of(phantom: Any, path: Path) -> Path:
    """A CT of an imported phantom: contrast in the vessels, soft tissue 3 cm around them, air further away."""
    nibabel = pytest.importorskip("nibabel", reason="a CT needs nibabel")
    report, step = phantom.imported, 2.5e-3
    bounds = np.asarray(phantom.grid.bounds)
    low, high = bounds[0] - 0.04, bounds[1] + 0.04
    places = np.stack(np.meshgrid(*(np.arange(a, b, step) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    values = np.where((np.abs(places - (low + high) / 2) < (high - low) / 2 - 0.01).all(axis=-1), 0, -1000)
    values[phantom.grid.sample(places) > 0] = 350
    values[places[..., 0] < low[0] + 0.02] = 800
    turn = 1e3 * np.diag([-1.0, -1.0, 1.0]) @ np.array(report.rotation).T  # to a file in LPS, in mm
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * step, turn @ (low - np.array(report.offset))
    nibabel.save(nibabel.Nifti1Image(values.astype(np.int16), affine), path)
    return path
