"""Calibration of a rig of detectors: distortion by a perforated sheet, cameras by a bead cube, without a click.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from guide3d.lazy_names import imported

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
    return imported(__name__, _HOME, name)
