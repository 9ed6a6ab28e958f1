"""Cameras of a C-arm from its angles and distances, in a world that stands still at the isocentre.

World frame, mm: the origin is the isocentre, about which the C-arm turns; +x to the patient's left, +y to the back,
+z to the head. The primary angle p turns the detector about +z from the front (0) to the patient's left (+90, LAO) or
right (-90, RAO); the secondary angle s then raises it towards the head (CRA, positive) or the feet (CAU). From the
isocentre the detector lies along (sin p cos s, -cos p cos s, sin s), and the source opposite: at 0, 0 the patient
faces the detector. A picture is seen from the detector, upright: head up and, from the front, the patient's left on the
right.

Source:
    DICOM PS3.3, C.8.7.5.1.2 and figures C.8-11 and C.8-12 (angles); C.8.19.6.13.1.2 (rows and columns of the detector).
"""

from __future__ import annotations

import numpy as np

from guide3d.dicom.xray_run import XrayRun
from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array

_SIDES = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "H": (0, 0, 1), "F": (0, 0, -1)}
_DETECTOR_MM = (300.0, 3000.0)  # from the source; 900 to 1300 mm in a C-arm
_PIXEL_MM = (0.001, 100.0)  # any detector's; what lies beyond is a damaged number
_AGAINST = -0.3  # cosine between where a row runs and where the file says it does


def detector_axes(primary_deg: float, secondary_deg: float) -> Array:
    """The picture's right, its down, and from source to detector, in the world: (3, 3), a row each.

    They are left-handed: the picture is the mirror image of what the source sees.
    """
    p, s = np.radians(primary_deg), np.radians(secondary_deg)
    right = [np.cos(p), np.sin(p), 0.0]
    down = [np.sin(p) * np.sin(s), -np.cos(p) * np.sin(s), -np.cos(s)]
    ahead = [np.sin(p) * np.cos(s), -np.cos(p) * np.cos(s), np.sin(s)]
    return np.array([right, down, ahead])


def camera_of(run: XrayRun, frame: int = 0) -> Camera:
    """The camera of a frame, counted from 0, in the world of this module, without a covariance.

    The central ray is taken to meet the middle of the picture. As the picture is seen from the detector, no rotation
    takes the world to it: R is the rotation to the opposite axes, in which depths are negative. Projection and
    triangulation do not depend on that.

    Raises:
        IndexError: there is no such frame.
        ValueError: an angle or a distance is missing or impossible; the message names it.
    """
    if not 0 <= frame < len(run):
        raise IndexError(f"{run.path}: expected a frame from 0 to {len(run) - 1}, found {frame}")
    needed = {
        "PositionerPrimaryAngle (0018,1510)": run.primary_deg[frame],
        "PositionerSecondaryAngle (0018,1511)": run.secondary_deg[frame],
        "DistanceSourceToDetector (0018,1110)": run.source_detector_mm[frame],
        "DistanceSourceToPatient (0018,1111)": run.source_isocentre_mm[frame],
        "ImagerPixelSpacing (0018,1164)": run.pixel_mm[frame].sum(),
    }
    missing = [name for name, value in needed.items() if np.isnan(value)]
    if missing:
        raise ValueError(f"{run.path}: a camera needs {', '.join(missing)}, which the file does not have")
    primary, secondary, detector, isocentre, _ = (float(value) for value in needed.values())
    if not 0 < isocentre < detector or not _DETECTOR_MM[0] <= detector <= _DETECTOR_MM[1]:
        raise ValueError(
            f"{run.path}: expected the isocentre between source and detector, these {_DETECTOR_MM[0]:g} to "
            f"{_DETECTOR_MM[1]:g} mm apart, found it {isocentre:g} mm from the source and the detector {detector:g} "
            "mm: are the distances in millimetres?"
        )
    if abs(primary) > 180 or abs(secondary) > 90:
        raise ValueError(
            f"{run.path}: expected a primary angle from -180 to 180 and a secondary one from -90 to 90 degrees, found "
            f"{primary:g} and {secondary:g}"
        )
    smallest, largest = _PIXEL_MM
    if not ((smallest <= run.pixel_mm[frame]) & (run.pixel_mm[frame] <= largest)).all():
        raise ValueError(
            f"{run.path}: expected a pixel spacing from {smallest:g} to {largest:g} mm, found "
            f"{run.pixel_mm[frame].tolist()} mm"
        )
    height, width = run.frames.shape[1:]
    fx, fy = detector / run.pixel_mm[frame]
    K = np.array([[fx, 0.0, (width - 1) / 2], [0.0, fy, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(K, -detector_axes(primary, secondary), np.array([0.0, 0.0, -isocentre]), width, height)


def view_warnings(run: XrayRun) -> list[str]:
    """What speaks against `camera_of` for the first frame, a sentence each."""
    warnings = []
    if run.beam_tilt_deg > 0.5:
        warnings.append(
            f"{run.path.name}: the beam stands {run.beam_tilt_deg:.1f} degrees askew on the detector, which the camera "
            "leaves out"
        )
    axes = detector_axes(float(run.primary_deg[0]), float(run.secondary_deg[0]))
    for what, word, axis in zip(("rows", "columns"), run.orientation, axes[:2], strict=False):
        side = _SIDES.get(word[:1])
        if side is not None and np.isfinite(axis).all() and float(axis @ np.array(side)) < _AGAINST:
            warnings.append(
                f"{run.path.name}: by the angles, {what} run away from the side {word[:1]} of the patient to which the "
                "file says they run: the pictures seem mirrored or turned"
            )
    return warnings
