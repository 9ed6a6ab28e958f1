"""Draw the picture of the calibration page: a synthetic cube, its beads found, numbered and reprojected.

python docs/pictures/calibration_picture.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from guide3d.calibration.cube_calibration import calibrate_folder
from guide3d.calibration.pictures import draw_beads, draw_displacement
from guide3d.geometry.camera import Camera
from guide3d.image_file import write_png
from guide3d.opencv import cv2
from tests.guide3d.calibration.synthetic_xray import SyntheticDetector, cube_points_mm, draw_cube, draw_sheet

SIDE = 560


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
