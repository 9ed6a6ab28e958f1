"""Calibration of a rig of detectors: distortion by a perforated sheet, cameras by a bead cube, without a click.

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from guide3d.calibration.cube_calibration import CubeCalibration as CubeCalibration
    from guide3d.calibration.cube_calibration import calibrate_cube as calibrate_cube
    from guide3d.calibration.cube_calibration import calibrate_folder as calibrate_folder
    from guide3d.calibration.perforated_sheet import SheetHoles as SheetHoles
    from guide3d.calibration.perforated_sheet import find_holes as find_holes
    from guide3d.calibration.rig import RigCalibration as RigCalibration
    from guide3d.calibration.rig import Sighting as Sighting
    from guide3d.calibration.rig import calibrate_rig as calibrate_rig

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "cube_calibration": "CubeCalibration calibrate_cube calibrate_folder",
        "perforated_sheet": "SheetHoles find_holes",
        "rig": "RigCalibration Sighting calibrate_rig",
    },
)
