"""A ball as a phantom's grid of distances, clamped far outside as those of phantoms are."""

from types import SimpleNamespace

import numpy as np

from cathsim.lattice.node_blocks import NodeBlocks

RADIUS, CENTRE = 0.012, np.array([0.004, -0.003, 0.002])  # m
HALF = 0.03  # m, of the grid's edge


def ball_grid() -> SimpleNamespace:
    axis = np.arange(-HALF, HALF + 5e-4, 1e-3)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = np.maximum(RADIUS - np.linalg.norm(points - CENTRE, axis=-1), -0.01).astype(np.float32)
    return SimpleNamespace(blocks=NodeBlocks.from_dense(values), origin=np.full(3, -HALF), spacing=1e-3)
