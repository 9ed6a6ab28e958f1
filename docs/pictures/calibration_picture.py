"""Draw the picture of the calibration page: a synthetic cube, its beads found, numbered and reprojected.

python docs/pictures/calibration_picture.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "guide3d"))

from calibration import draw_folder

from guide3d.calibration.cube_calibration import calibrate_folder
from guide3d.calibration.pictures import draw_beads, draw_displacement

SIDE = 560

with tempfile.TemporaryDirectory() as folder:
    draw_folder(Path(folder))
    calibration = calibrate_folder(folder)
    left = draw_displacement(calibration.holes["A"], calibration.distortions["A"])
    left = left.crop((0, 0, 1400, 1400)).resize((SIDE, SIDE), Image.Resampling.LANCZOS)
    # the part of the cube with the marked beads
    right = draw_beads(calibration, calibration.views["drawn", "A"]).crop((850, 580, 1690, 1420))
    right = right.resize((SIDE, SIDE), Image.Resampling.LANCZOS)
    picture = Image.new("RGB", (2 * SIDE + 10, SIDE), "white")
    for place, part in ((0, left), (SIDE + 10, right)):
        picture.paste(part, (place, 0))
    path = Path(__file__).parent / "guide3d_calibration.png"
    picture.save(path, optimize=True)
    print(path)
