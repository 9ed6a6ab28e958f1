"""DICOM: X-ray runs of angiography systems to images and cameras (`endonav-guide3d[dicom]`).

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from guide3d.lazy_names import lazy_names

if TYPE_CHECKING:
    from guide3d.dicom.c_arm import camera_of as camera_of
    from guide3d.dicom.pair import RunPair as RunPair
    from guide3d.dicom.pair import images_and_cameras as images_and_cameras
    from guide3d.dicom.run_folder import read_xray as read_xray
    from guide3d.dicom.xray_run import XrayRun as XrayRun

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "c_arm": "camera_of",
        "pair": "RunPair images_and_cameras",
        "run_folder": "read_xray",
        "xray_run": "XrayRun",
    },
)
