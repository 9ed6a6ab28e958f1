"""Draw the picture of the calibration page: a synthetic cube, its beads found, numbered and reprojected.

python docs/pictures/calibration_picture.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "guide3d"))

from calibration import draw_folder

from guide3d.calibration.cube_calibration import calibrate_folder
from guide3d.calibration.pictures import draw_beads, draw_displacement
from guide3d.image_file import write_png
from guide3d.opencv import cv2

SIDE = 560

with tempfile.TemporaryDirectory() as folder:
    draw_folder(Path(folder))
    calibration = calibrate_folder(folder)
    left = draw_displacement(calibration.holes["A"], calibration.distortions["A"])
    left = cv2.resize(left[:1400, :1400], (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    # the part of the cube with the marked beads
    right = draw_beads(calibration, calibration.views["drawn", "A"])[580:1420, 850:1690]
    right = cv2.resize(right, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    picture = np.concatenate([left, np.full((SIDE, 10, 3), 255, np.uint8), right], axis=1)
    path = Path(__file__).parent / "guide3d_calibration.png"
    write_png(picture, path)
    print(path)
