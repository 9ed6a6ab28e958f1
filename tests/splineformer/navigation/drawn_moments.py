"""A bent lumen, readings of straight wires, and untrained perception networks, for tests of the navigation."""

import numpy as np

from splineformer.navigation.perception import CURVE_POINTS, PerceptionNetwork, WireReading
from splineformer.predictor import Predictor
from tests.splineformer.curves import network


def perception_network(variant: str = "ordered") -> PerceptionNetwork:
    return PerceptionNetwork(Predictor(network(variant), source_px=256))


def bend() -> np.ndarray:
    """A lumen like an L: up along the left side, then to the right."""
    lumen = np.zeros((64, 64))
    lumen[8:60, 8:16] = lumen[8:16, 8:60] = 1.0
    return lumen


def straight(tip: tuple[float, float], length: float = 0.4) -> WireReading:
    """A wire that comes from below and ends at a tip."""
    points = np.array(tip) + np.linspace(0, length, CURVE_POINTS)[:, None] * (0.0, 1.0)
    return WireReading(np.zeros((5, 3), np.float32), points.astype(np.float32), np.zeros(8, np.float32), 0.9)
