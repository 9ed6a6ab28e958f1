"""A tiny data set in the public layout, drawn without a simulator."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from guide3d.dataset.annotation_files import Annotation, Views, acquisition_name, image_name, write_curves, write_raw
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import strip_mask
from guide3d.dataset.true_curves import TrueCurve, write_truth
from guide3d.geometry.bspline import fit_bspline
from guide3d.geometry.camera import Camera, write_camera
from guide3d.geometry.polyline import arc_length

SIZE = 128


def cameras() -> dict[str, Camera]:
    """Two views at right angles, 0.5 mm a pixel in the middle of the world."""
    K = np.array([[2000.0, 0, (SIZE - 1) / 2], [0, 2000.0, (SIZE - 1) / 2], [0, 0, 1]])
    lower = K + np.array([[0.0, 0, 0], [0, 0, 12], [0, 0, 0]])  # or nobody could tell the views apart
    a, b = np.eye(3), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    return {
        "a": Camera(K, a, np.array([0.0, 0, 1000.0]), SIZE, SIZE, "16710"),
        "b": Camera(lower, b, np.array([0.0, 0, 1000.0]), SIZE, SIZE, "16709"),
    }


def wire(phase: float) -> np.ndarray:
    """(200, 3) mm, an arch about the world's origin."""
    t = np.linspace(0.0, 1.0, 200)
    return np.column_stack([15 * np.cos(3 * t + phase), 24 * t - 12, 9 * np.sin(4 * t + phase)])


def annotation(
    acquisition: str, number: int, curve: np.ndarray, views: Sequence[Camera] | None = None, every: int = 4
) -> Annotation:
    """Of both views of a curve, exact, every so many of its points."""
    points = [camera.project(curve)[::every] for camera in views or cameras().values()]
    images = [image_name(acquisition, name, number) for name in ("a", "b")]
    wired = "angled" if "-angle-" in acquisition else "straight"
    return Annotation(acquisition, number, acquisition[0] == "1", wired, *images, *points)


def write_moments(
    root: Path,
    views: Sequence[Camera],
    moments: Mapping[tuple[str, int], tuple[Annotation, np.ndarray, Sequence[np.ndarray]]],
    visible_mm: float | None = None,
) -> None:
    """Writes moments' annotations, curves (n, 3) mm and images, and the cameras; None: a whole curve is visible."""
    truths = {}
    for moment, (one, curve, images) in moments.items():
        end = float(arc_length(curve)[-1]) if visible_mm is None else visible_mm
        truths[moment] = TrueCurve(curve, (end, end))
        for file, image in zip((one.image_a, one.image_b), images, strict=False):
            path = root / "images" / file
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(path)
    root.mkdir(exist_ok=True)
    write_raw(root / "raw.json", [one for one, _, _ in moments.values()])
    write_truth(root / "truth.json", truths)
    for camera in views:
        write_camera(camera, root / "calibration" / f"projection_{camera.name}.txt")
    (root / "dataset.json").write_text(json.dumps({"undistorted": True, "image_size_px": views[0].width}))


def write_dataset(root: Path, *, acquisitions: int = 4, frames: int = 3, images: bool = True) -> Dataset:
    """Writes annotations, images, cameras and truth, and opens them; half with fluid, half of each with either wire."""
    moments, curves = {}, {}
    for index in range(acquisitions):
        name = acquisition_name(index % 2 == 0, "bca", ("angled", "straight")[index // 2 % 2], index + 1)
        for number in range(frames):
            curve = wire(0.4 * index + 0.05 * number)
            one = annotation(name, number, curve)
            dark = [strip_mask(points, SIZE, SIZE, 3.0) for points in (one.points_a, one.points_b) if images]
            moments[name, number] = one, curve, [np.where(d, 60, 180 + number).astype(np.uint8) for d in dark]
            curves[name, number] = Views(fit_bspline(one.points_a), fit_bspline(one.points_b), fit_bspline(curve))
    write_moments(root, list(cameras().values()), moments)
    write_curves(root / "sphere.json", [one for one, _, _ in moments.values()], curves)
    return Dataset.open(root)
