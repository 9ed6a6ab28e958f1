"""An X-ray pair of your own: two images and their cameras to the wire in space.

    python examples/own_xray_pair.py [A.png B.png CAMERA_A.txt CAMERA_B.txt]

Without arguments a pair is drawn by the simulator, so that the error is known. A camera's file holds K, R and t.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from cathsim import NavigateEnv
from cathsim.fluoroscopy import BiplaneFluoroscope, write_calibration
from guide3d import read_camera, read_pair


def draw(folder: Path) -> tuple[list[str], np.ndarray]:
    """Write an X-ray pair with its cameras; give the files and the true wire, (n, 3) mm."""
    env = NavigateEnv("type_1", "bca", observation="tip")
    env.reset(seed=0)
    for _ in range(70):
        env.step(np.array([1.0, 0.15]))
    fluoroscope = BiplaneFluoroscope.of(env.phantom, "clinical", surroundings="patient", size=1024)
    wire = env.simulation.wire_points()
    for name, frame in fluoroscope.render(wire, seed=1).items():
        Image.fromarray(frame.image).save(folder / f"{name}.png")
    write_calibration(fluoroscope.cameras, folder)
    return [str(folder / name) for name in ("a.png", "b.png", "projection_a.txt", "projection_b.txt")], 1e3 * wire


def main(*files: str) -> float | None:
    """Read the wire; give its mean distance from the true one, mm, where that is known."""
    with TemporaryDirectory() as folder:
        given, truth = (files, None) if files else draw(Path(folder))
        images = [np.asarray(Image.open(path)) for path in given[:2]]
        wire = read_pair(*images, [read_camera(path) for path in given[2:]])
    print(f"{len(wire.curve_mm)} points, tip at {wire.curve_mm[0].round(1)} mm, {wire.sd_mm.mean():.2f} mm uncertain")
    print("one wire in both images" if wire.accepted else "; ".join(wire.messages))
    if truth is None:
        return None
    fine = np.concatenate([truth[:-1] + share * np.diff(truth, axis=0) for share in np.linspace(0, 1, 20)])
    error = cKDTree(fine).query(wire.curve_mm)[0]
    print(f"mean distance from the simulated wire: {error.mean():.2f} mm")
    return float(error.mean())


if __name__ == "__main__":
    main(*sys.argv[1:])
