"""Two X-ray runs of one moment, from two directions: their images and cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from guide3d.dicom.c_arm import camera_of, view_warnings
from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from guide3d.geometry.camera import Camera

_LEAST_ANGLE_DEG = 10.0  # between the central rays, below which depth is hardly seen
_TABLE_MM = 1.0


@dataclass(frozen=True, eq=False)
class RunPair:
    """Images and cameras of two runs; frame k of one belongs to frame k of the other.

    images_a, images_b: (n, h, w) and (n, k, l) uint8, 0 black
    cameras_a, cameras_b: n cameras each, world mm about the isocentre (`guide3d.dicom.c_arm`)
    times_ms: (n,) of the first run, or None
    """

    images_a: NDArray[np.uint8]
    images_b: NDArray[np.uint8]
    cameras_a: tuple[Camera, ...]
    cameras_b: tuple[Camera, ...]
    times_ms: NDArray[np.float64] | None
    warnings: tuple[str, ...]


def images_and_cameras(path_a: str | Path, path_b: str | Path) -> RunPair:
    """Reads both planes of a biplane run, or two runs of one C-arm between which nothing moved.

    Where one run is longer, its further frames are left out.

    Raises:
        FileNotFoundError: a file is missing.
        ImportError: pydicom is not installed.
        ValueError: a file is no X-ray run or lacks what a camera needs, or both views have one direction.
    """
    return paired(read_xray(path_a), read_xray(path_b))


def paired(run_a: XrayRun, run_b: XrayRun) -> RunPair:
    """As `images_and_cameras`, of runs that were read already."""
    runs = run_a, run_b
    cameras = [[camera_of(run, frame) for frame in range(len(run))] for run in runs]
    warnings = [f"{run.path.name}: {warning}" for run in runs for warning in run.warnings]
    warnings += [warning for run in runs for warning in view_warnings(run)]
    angle = view_angle_deg(cameras[0][0], cameras[1][0])
    if min(angle, 180 - angle) < 0.5:
        raise ValueError(
            f"{runs[0].path} and {runs[1].path} look along one line ({angle:.1f} degrees between their central rays): "
            "expected two directions"
        )
    if min(angle, 180 - angle) < _LEAST_ANGLE_DEG:
        warnings.append(f"the central rays are only {angle:.1f} degrees apart, so depth is uncertain")
    n = min(len(run) for run in runs)
    if len(runs[0]) != len(runs[1]):
        warnings.append(f"the runs have {len(runs[0])} and {len(runs[1])} frames: the first {n} of both are taken")
    warnings += _table_warnings(runs)
    times = [run.times_ms for run in runs]
    if times[0] is not None and times[1] is not None and n > 1:
        apart = float(np.abs(times[0][:n] - times[1][:n]).max())
        if apart > 0.5 * np.diff(times[0][:n]).mean():
            warnings.append(
                f"the runs have different frame rates: frames of one number are up to {apart:.0f} ms apart, counted "
                "from the first"
            )
    return RunPair(
        images_a=runs[0].images()[:n],
        images_b=runs[1].images()[:n],
        cameras_a=tuple(cameras[0][:n]),
        cameras_b=tuple(cameras[1][:n]),
        times_ms=None if runs[0].times_ms is None else runs[0].times_ms[:n],
        warnings=tuple(warnings),
    )


def view_angle_deg(camera_a: Camera, camera_b: Camera) -> float:
    """Angle between the central rays of two cameras."""
    return float(np.degrees(np.arccos(np.clip(camera_a.R[2] @ camera_b.R[2], -1.0, 1.0))))


def _table_warnings(runs: tuple[XrayRun, XrayRun]) -> list[str]:
    warnings = []
    for run in runs:
        moved = np.ptp(run.table_mm, axis=0)
        if np.nanmax(moved, initial=0.0) > _TABLE_MM:
            warnings.append(
                f"{run.path.name}: the table moves by {np.nanmax(moved):.0f} mm during the run, and the patient with it"
            )
    apart = np.abs(runs[0].table_mm[0] - runs[1].table_mm[0])
    if np.nanmax(apart, initial=0.0) > _TABLE_MM:
        warnings.append(
            f"the table stands {np.nanmax(apart):.0f} mm apart in the two runs: the views show the patient at two "
            "places, and the curve in space will be wrong"
        )
    return warnings
