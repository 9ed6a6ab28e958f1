"""Calibration of a folder of sheet and cube images: holes, leave-out error of the distortion map, beads, reprojection.

    python benchmarks/guide3d/calibration.py DIR
    python benchmarks/guide3d/calibration.py --quick

DIR holds undistort_<detector>.*, <pose>_<detector>.*, framespec_cm.csv and, if beads are marked, a .ref file. Without
DIR (--quick), a synthetic sheet and cube are drawn and calibrated. Prints a table, and one JSON object last.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from guide3d.calibration.cube_calibration import calibrate_folder
from guide3d.calibration.report import figures
from guide3d.calibration.synthetic_xray import SyntheticDetector, cube_points_mm, draw_cube, draw_sheet
from guide3d.geometry.camera import Camera
from guide3d.image_file import write_png


def draw_folder(folder: Path, seed: int = 0) -> None:
    """Draw a sheet and a cube for two detectors into a folder."""
    rng = np.random.default_rng(seed)
    points = cube_points_mm()
    marked = {"circle": 21, "double": 25, "single": 38}
    for name, azimuth, focal, distance, swirl in (("A", 0.4, 5100.0, 1150.0, 0.03), ("B", 1.99, 4450.0, 900.0, -0.02)):
        detector = SyntheticDetector(swirl=swirl)
        z = np.array([np.cos(azimuth), np.sin(azimuth), 0.06])
        z /= np.linalg.norm(z)
        x = np.cross([0.0, 0.0, -1.0], z)
        x /= np.linalg.norm(x)
        R = np.array([x, np.cross(z, x), z])
        K = np.array([[focal, 9.0, 500.0], [0.0, 0.995 * focal, 530.0], [0.0, 0.0, 1.0]])
        camera = Camera(K, R, -R @ (points.mean(axis=0) - distance * z), 1024, 1024)
        write_png(draw_sheet(detector, rng, irregular=0.1)[0], folder / f"undistort_{name}.png")
        write_png(draw_cube(detector, camera, points, rng, marked)[0], folder / f"drawn_{name}.png")
    rows = "\n".join(",".join(f"{value:g}" for value in row) for row in points / 10)
    (folder / "framespec_cm.csv").write_text(f"x,y,z\n{rows}\n")
    (folder / "marks.ref").write_text("".join(f"{bead + 1} {kind}\n" for kind, bead in marked.items()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", help="of images; none draws synthetic ones")
    parser.add_argument("--quick", action="store_true", help="on synthetic images")
    parser.add_argument("--swirl", choices=("auto", "never", "always"), default="auto")
    chosen = parser.parse_args()
    if chosen.folder is None and not chosen.quick:
        parser.error("expected a folder of images, or --quick")
    with tempfile.TemporaryDirectory() as drawn:
        if chosen.folder is None:
            draw_folder(Path(drawn))
        start = time.process_time()
        try:
            calibration = calibrate_folder(chosen.folder or drawn, chosen.swirl)
        except (OSError, ValueError) as error:
            sys.stderr.write(f"{error}\n")
            return 1
        seconds = time.process_time() - start
    result = figures(calibration)
    print(f"{'detector':10} {'holes':>6} {'leave-out':>10} {'spline':>8} {'swirl':>8}   (px)")
    for detector, own in result.items():
        print(
            f"{detector:10} {own['holes']:6d} {own['leave_out_px']:10.3f} {own['spline_leave_out_px']:8.3f} "
            f"{own['swirl_px']:8.2f}"
        )
    print(
        f"\n{'image':24} {'beads':>6} {'used':>5} {'unseen':>7} {'mean':>7} {'rms':>7} {'max':>7} {'alone':>7}   (px)"
    )
    for detector, own in result.items():
        for name, image in own["images"].items():
            print(
                f"{name + '_' + detector:24} {image['beads']:6d} {image['used']:5d} {image['unseen']:7d} "
                f"{image['mean_px']:7.3f} {image['rms_px']:7.3f} {image['max_px']:7.2f} {image['alone_mean_px']:7.3f}"
            )
    for warning in calibration.warnings:
        print(warning)
    print(f"\n{seconds:.1f} s CPU")
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
