"""DICOM: X-ray runs of angiography systems to images and cameras (`endonav-guide3d[dicom]`).

Names are imported at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from guide3d.lazy_names import imported

if TYPE_CHECKING:
    from guide3d.dicom.c_arm import camera_of
    from guide3d.dicom.pair import RunPair, images_and_cameras
    from guide3d.dicom.xray_run import XrayRun, read_xray

_HOME = {
    "RunPair": "pair",
    "XrayRun": "xray_run",
    "camera_of": "c_arm",
    "images_and_cameras": "pair",
    "read_xray": "xray_run",
}

__all__ = ["RunPair", "XrayRun", "camera_of", "images_and_cameras", "read_xray"]


def __getattr__(name: str) -> Any:
    return imported(__name__, _HOME, name)
