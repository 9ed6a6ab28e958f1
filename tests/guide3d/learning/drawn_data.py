"""A small drawn data set in the public layout: dark arcs on a bright ground, seen by two cameras, with the truth."""

from pathlib import Path

import numpy as np
from PIL import Image

from guide3d.dataset.annotation_files import Annotation, image_name, write_raw
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import strip_mask
from guide3d.dataset.true_curves import TrueCurve, write_truth
from guide3d.geometry.camera import Camera, write_camera

SIDE = 128


def cameras() -> tuple[Camera, Camera]:
    """Two cameras at right angles, 1 m from the origin; 1 mm there is about 0.65 px."""
    K = np.array([[650.0, 0, 63.5], [0, 650.0, 63.5], [0, 0, 1]])
    turned = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    return tuple(  # type: ignore[return-value]
        Camera(K=K, R=R, t_mm=np.array([0.0, 0, 1000.0]), width=SIDE, height=SIDE, name=name)
        for name, R in (("A", np.eye(3)), ("B", turned))
    )


def wire(turn: float, reach: float) -> np.ndarray:
    """(n, 3) mm, tip first: a helix of some turns that comes down to the same place."""
    along = np.linspace(0, 1, 200)
    angle = turn + 2.5 * along
    radius = 15 + 25 * along
    return np.stack((radius * np.cos(angle), 70 * along - 10 - reach * (1 - along), radius * np.sin(angle)), axis=1)


def draw(root: Path, *, acquisitions: int = 6, frames: int = 4) -> Dataset:
    """Writes the data set and opens it."""
    views = cameras()
    annotations, truths = [], {}
    rng = np.random.default_rng(0)
    for number in range(acquisitions):
        fluid, kind = bool(number % 2), "straight" if number % 3 == 0 else "angle"
        name = f"{int(fluid)}-bca-{kind}-{number}"
        turn = rng.uniform(-1, 1)
        for frame in range(frames):
            curve = wire(turn + 0.1 * frame, 20 * rng.uniform() + frame)
            points = [view.project(curve) for view in views]
            files = []
            for camera, line in zip("ab", points, strict=True):
                file = root / "images" / image_name(name, camera, frame)
                file.parent.mkdir(parents=True, exist_ok=True)
                ground = 150 + 10 * rng.standard_normal((SIDE, SIDE))
                ground[strip_mask(line, SIDE, SIDE, 2.0) > 0] -= 70
                Image.fromarray(np.clip(ground, 0, 255).astype(np.uint8)).save(file)
                files.append(image_name(name, camera, frame))
            wire_name = "straight" if kind == "straight" else "angled"
            annotations.append(Annotation(name, frame, fluid, wire_name, *files, *points))
            truths[name, frame] = TrueCurve(curve, (1e9, 1e9))
    write_raw(root / "raw.json", annotations)
    write_truth(root / "truth.json", truths)
    for camera, detector in zip(views, ("16710", "16709"), strict=True):
        write_camera(camera, root / "calibration" / f"projection_{detector}.txt")
    (root / "dataset.json").write_text('{"image_size_px": 128, "undistorted": true}')
    return Dataset.open(root)
