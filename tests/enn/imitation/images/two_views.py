"""A vessel with a branch, what overlaps it in one view, and a wire in it, drawn in two calibrated views, for tests."""

import itertools

import numpy as np
from scipy import ndimage

from enn.imitation.images.stereo_geometry import StereoGeometry
from enn.imitation.images.visual_hull import SeenVoxels

SIZE, FIELD = 160, 0.16


def projections(angle_deg: float = 45.0) -> np.ndarray:
    """Two cameras 0.8 m from the isocentre, turned about the patient's long axis."""
    matrices = []
    for angle in np.deg2rad((0.0, angle_deg)):
        rotation = np.array([[np.cos(angle), np.sin(angle), 0], [0, 0, -1], [-np.sin(angle), np.cos(angle), 0]])
        camera = np.column_stack((rotation, (0.0, 0.0, 0.8)))
        focal = 0.8 / FIELD
        matrices.append(np.array([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]]) @ camera)
    return np.stack(matrices)


GEOMETRY = StereoGeometry(projections(), FIELD)
VOXELS = SeenVoxels(GEOMETRY)


def seen(points: np.ndarray, view: int) -> np.ndarray:
    """Rows and columns, shares of the image's side. Shape (n, 2)."""
    flat = np.column_stack((points, np.ones(len(points)))) @ GEOMETRY.projections[view].T
    return (flat[:, :2] / flat[:, 2:])[:, ::-1]


def tube(points: np.ndarray, radius: float, view: int) -> np.ndarray:
    """Its image."""
    image = np.zeros((SIZE, SIZE), bool)
    rows, columns = np.clip((seen(points, view) * SIZE).astype(int), 0, SIZE - 1).T
    image[rows, columns] = True
    return ndimage.distance_transform_edt(~image) <= radius / FIELD * SIZE


def line(*corners: tuple[float, float, float]) -> np.ndarray:
    """Points every 0.2 mm or so along a polyline given in mm."""
    parts = [np.linspace(a, b, 400) for a, b in itertools.pairwise(corners)]
    return np.concatenate(parts) * 1e-3


TRUNK = line((-30, 20, -70), (-30, 20, 30))
BRANCH = line((-30, 20, 10), (35, -25, 40))
BESIDE = line((-30, 20, 20), (-30, -40, 50))  # in the frontal view it lies on the trunk
TARGET = np.array([0.03, -0.0215, 0.0377])
WIRE = line((-27, 17.9, 9), (-30, 20, 4), (-30, 20, -70))  # from the tip on


def lumens() -> list[np.ndarray]:
    """Images of the vessels in both views."""
    return [np.any([tube(part, 7e-3, k) for part in (TRUNK, BRANCH, BESIDE)], axis=0).astype(float) for k in (0, 1)]
