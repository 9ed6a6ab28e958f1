"""A small drawn data set in the public layout: dark arcs on a bright ground, seen by two cameras, with the truth."""

from pathlib import Path

import numpy as np

from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import strip_mask
from guide3d.geometry.camera import Camera
from tests.guide3d.dataset.drawn_dataset import annotation, write_moments

SIDE = 128


def cameras() -> tuple[Camera, Camera]:
    """Two cameras at right angles, 1 m from the origin; 1 mm there is about 0.65 px."""
    K = np.array([[650.0, 0, 63.5], [0, 650.0, 63.5], [0, 0, 1]])
    turned = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    return tuple(  # type: ignore[return-value]
        Camera(K=K, R=R, t_mm=np.array([0.0, 0, 1000.0]), width=SIDE, height=SIDE, name=name)
        for name, R in (("16710", np.eye(3)), ("16709", turned))
    )


def wire(turn: float, reach: float) -> np.ndarray:
    """(n, 3) mm, tip first: a helix of some turns that comes down to the same place."""
    along = np.linspace(0, 1, 200)
    angle = turn + 2.5 * along
    radius = 15 + 25 * along
    return np.stack((radius * np.cos(angle), 70 * along - 10 - reach * (1 - along), radius * np.sin(angle)), axis=1)


def draw(root: Path, *, acquisitions: int = 6, frames: int = 4) -> Dataset:
    """Writes the data set and opens it."""
    views, rng, moments = cameras(), np.random.default_rng(0), {}
    for number in range(acquisitions):
        name = f"{number % 2}-bca-{'straight' if number % 3 == 0 else 'angle'}-{number}"
        turn = rng.uniform(-1, 1)
        for frame in range(frames):
            curve = wire(turn + 0.1 * frame, 20 * rng.uniform() + frame)
            one, images = annotation(name, frame, curve, views, every=1), []
            for line in (one.points_a, one.points_b):
                ground = 150 + 10 * rng.standard_normal((SIDE, SIDE))
                ground[strip_mask(line, SIDE, SIDE, 2.0) > 0] -= 70
                images.append(np.clip(ground, 0, 255).astype(np.uint8))
            moments[name, frame] = one, curve, images
    write_moments(root, views, moments, visible_mm=1e9)
    return Dataset.open(root)
