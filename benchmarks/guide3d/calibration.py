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

from guide3d.calibration.__main__ import figures
from guide3d.calibration.cube_calibration import calibrate_folder
from tests.guide3d.calibration.drawn_cube import write_folder


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
            write_folder(Path(drawn))
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
