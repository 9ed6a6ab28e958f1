"""A drawn sheet and cube of half the real size, for the calibration tests, with everything about them known."""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import Distortion
from tests.guide3d.calibration.synthetic_xray import SyntheticDetector, cube_points_mm, draw_cube, draw_sheet

MARKED = {"circle": 21, "double": 25, "single": 38}
DETECTORS = {
    "A": SyntheticDetector(512, 512, swirl=0.03, field=1.2),
    "B": SyntheticDetector(512, 512, swirl=-0.02, pincushion=0.04, field=1.2),
}
POINTS_MM = cube_points_mm()


def looking_camera(azimuth: float, focal_px: float, distance_mm: float, size: int = 512) -> Camera:
    """A camera that looks at the middle of the cube, a little from above, upright."""
    z = np.array([np.cos(azimuth), np.sin(azimuth), 0.06])
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 0.0, -1.0], z)
    x /= np.linalg.norm(x)
    R = np.array([x, np.cross(z, x), z])
    K = np.array([[focal_px, 0.002 * focal_px, 0.49 * size], [0.0, 0.995 * focal_px, 0.52 * size], [0.0, 0.0, 1.0]])
    return Camera(K, R, -R @ (POINTS_MM.mean(axis=0) - distance_mm * z), size, size)


CAMERAS = {"A": looking_camera(0.4, 2550.0, 1150.0), "B": looking_camera(1.99, 2225.0, 950.0)}


def turned_cube(camera: Camera, rotation: np.ndarray, shift_mm: np.ndarray) -> Camera:
    """The camera in the frame of a cube that was turned about its middle and shifted."""
    s = POINTS_MM.mean(axis=0) - rotation @ POINTS_MM.mean(axis=0) + shift_mm
    return Camera(camera.K, camera.R @ rotation, camera.t_mm + camera.R @ s, camera.width, camera.height)


def drawn_sheet(detector: str, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return draw_sheet(DETECTORS[detector], rng, pitch_px=13.0, angle=0.3 if detector == "A" else -0.8)


def drawn_cube_image(
    detector: str, camera: Camera, seed: int = 0, **wishes
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return draw_cube(DETECTORS[detector], camera, POINTS_MM, rng, MARKED, bead_mm=5.0, **wishes)


def write_folder(folder: Path) -> Path:
    """Write sheet, cube, bead and reference files of both detectors, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, camera in CAMERAS.items():
        Image.fromarray(drawn_sheet(name)[0]).save(folder / f"undistort_{name}.png")
        image = drawn_cube_image(name, camera, clutter=2, left_out=0.05)[0]
        Image.fromarray(image).save(folder / f"pose1_{name}.png")
    rows = "\n".join(",".join(f"{value:g}" for value in row) for row in POINTS_MM / 10)
    (folder / "framespec_cm.csv").write_text(f"x,y,z\n{rows}\n")
    (folder / "marks.ref").write_text("".join(f"{bead + 1} {kind}\n" for kind, bead in MARKED.items()))
    return folder


def among_holes(distortion: Distortion, raw: np.ndarray) -> np.ndarray:
    """Which raw pixels (n, 2) lie among the sheet's holes, where the distortion is measured: (n,) bool."""
    tree = cKDTree(distortion.raw_px)
    pitch = np.median(tree.query(distortion.raw_px, k=2)[0][:, 1])
    return tree.query(raw)[0] <= 1.2 * pitch
