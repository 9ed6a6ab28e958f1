"""Command line of DICOM: python -m guide3d.dicom FILE [FILE_B] --output FOLDER.

Writes FOLDER/a/000.png and so on, FOLDER/camera_a.yaml (OpenCV YAML, world mm about the isocentre) and FOLDER/runs.json
(times, angles, distances), and with a second file the same for "b". Nothing of the patient is read, so none is written.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guide3d.commands import in_words, run
from guide3d.dicom.c_arm import camera_of, view_warnings
from guide3d.dicom.pair import paired
from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from guide3d.files import whole_file
from guide3d.geometry.camera import Camera, write_opencv_yaml
from guide3d.image_file import write_png


def write_run(run: XrayRun, camera: Camera, folder: Path, view: str, frames: Sequence[int]) -> dict[str, Any]:
    """Writes pictures of a run, and a camera.

    Args:
        view: "a" or "b", for the names.
        frames: to write, counted from 0.

    Returns:
        What the run is, in plain JSON values.

    Raises:
        OSError: the folder cannot be written.
    """
    for number in frames:
        write_png(run.image(number), folder / view / f"{number:03d}.png")
    write_opencv_yaml(camera, folder / f"camera_{view}.yaml")
    return {
        "frames": len(run),
        "width": camera.width,
        "height": camera.height,
        "stored_bits": int(np.log2(run.grey.shape[1])),
        "times_ms": _plain(run.times_ms),
        "primary_deg": _plain(run.primary_deg),
        "secondary_deg": _plain(run.secondary_deg),
        "source_detector_mm": _plain(run.source_detector_mm),
        "source_isocentre_mm": _plain(run.source_isocentre_mm),
        "pixel_mm": _plain(run.pixel_mm),
        "field_of_view_mm": list(run.field_of_view_mm),
        "field_of_view_shape": run.field_of_view_shape,
        "table_mm": _plain(run.table_mm),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m guide3d.dicom", description="X-ray runs (DICOM XA) to pictures and camera files."
    )
    parser.add_argument("file", type=Path, help="a run, or plane A of a biplane run")
    parser.add_argument("file_b", type=Path, nargs="?", help="plane B, or a second run from another direction")
    parser.add_argument("--output", type=Path, required=True, help="folder for pictures and cameras")
    parser.add_argument("--frame", type=int, help="write this frame only, counted from 0, with its own camera")
    chosen = parser.parse_args(arguments)
    try:
        runs = [read_xray(path) for path in (chosen.file, chosen.file_b) if path is not None]
        if len(runs) == 2:
            warnings = list(paired(*runs).warnings)
        else:
            warnings = [f"{runs[0].path.name}: {warning}" for warning in runs[0].warnings] + view_warnings(runs[0])
        # everything that can be refused is, before the first file is written
        cameras = [_camera(run, chosen.frame) for run in runs]
        records = {}
        for view, run, camera in zip("ab", runs, cameras, strict=False):
            frames = range(len(run)) if chosen.frame is None else [chosen.frame]
            records[view] = write_run(run, camera, chosen.output, view, frames)
        with whole_file(chosen.output / "runs.json", "w") as file:
            file.write(json.dumps(records, indent=1) + "\n")
    except (OSError, ValueError, IndexError, ImportError) as error:
        sys.stderr.write(f"{in_words(error)}\n")
        return 1
    for view, run in zip("ab", runs, strict=False):
        sys.stdout.write(
            f"{view}: {len(run)} frames of {run.frames.shape[2]} x {run.frames.shape[1]} px, primary "
            f"{run.primary_deg[0]:.1f} and secondary {run.secondary_deg[0]:.1f} degrees\n"
        )
    for warning in warnings:
        sys.stdout.write(f"{warning}\n")
    sys.stdout.write(f"{chosen.output}\n")
    return 0


def _camera(run: XrayRun, frame: int | None) -> Camera:
    if frame is None and run.moves:
        raise ValueError(f"{run.path}: the C-arm turns during the run, so that one camera is not enough: add --frame N")
    return camera_of(run, frame or 0)


def _plain(values: np.ndarray | None) -> Any:
    """Lists with None for NaN, which JSON does not have."""
    if values is None:
        return None
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [None if np.isnan(value) else round(float(value), 6) for value in values]


if __name__ == "__main__":
    run(main)
