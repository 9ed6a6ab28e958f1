"""Calibration of a rig of detectors: distortion by a perforated sheet, cameras by a bead cube, without a click.

Names are imported at first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guide3d.calibration.cube_calibration import CubeCalibration, calibrate_cube, calibrate_folder
    from guide3d.calibration.perforated_sheet import SheetHoles, find_holes
    from guide3d.calibration.rig import RigCalibration, Sighting, calibrate_rig

_HOME = {
    "CubeCalibration": "cube_calibration",
    "RigCalibration": "rig",
    "SheetHoles": "perforated_sheet",
    "Sighting": "rig",
    "calibrate_cube": "cube_calibration",
    "calibrate_folder": "cube_calibration",
    "calibrate_rig": "rig",
    "find_holes": "perforated_sheet",
}

__all__ = ["CubeCalibration", "RigCalibration", "SheetHoles", "Sighting", "calibrate_cube", "calibrate_folder",
           "calibrate_rig", "find_holes"]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
