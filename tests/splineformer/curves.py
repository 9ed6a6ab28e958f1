"""Curves and images of wires with known truth, for the tests of splineformer."""

import numpy as np
import torch

from guide3d.dataset.frame import strip_mask
from guide3d.geometry.polyline import resample
from splineformer.build import build, size_of
from splineformer.modeling.curve_network import CurveNetwork
from splineformer.predictor import Predictor

SIDE = 256


def wavy_wire(seed: int = 0, side: int = SIDE, count: int = 200) -> np.ndarray:
    """A smooth wire that comes in from the left border and ends inside, tip first."""
    generator = np.random.default_rng(seed)
    x = np.linspace(0.0, generator.uniform(0.4, 0.8) * side, 100)
    phase, height = generator.uniform(0, 6.28), generator.uniform(0.3, 0.7) * side
    y = height + 0.08 * side * np.sin(x / (0.1 * side) + phase)
    return resample(np.column_stack([x, y])[::-1], count=count)


def loop(side: int = SIDE) -> np.ndarray:
    """A wire that crosses itself."""
    t = np.linspace(0.0, 1.0, 400)
    angle = 2.2 * np.pi * t
    x = (0.15 + 0.6 * t) * side + 0.12 * side * np.sin(angle)
    y = 0.5 * side + 0.16 * side * (1 - np.cos(angle))
    return np.column_stack([x, y])[::-1]


def image_of(points: np.ndarray, side: int = SIDE, seed: int = 0) -> np.ndarray:
    """A grey image of a dark wire on an uneven ground, uint8."""
    generator = np.random.default_rng(seed)
    slope = np.linspace(-15, 15, side)[None] + np.linspace(-10, 10, side)[:, None]
    wire = strip_mask(points, side, side, 4.0) > 0
    image = 150.0 + slope - 70.0 * wire + generator.normal(0, 2.0, (side, side))
    return np.clip(image, 0, 255).astype(np.uint8)


def network(variant: str, size: str = "smoke") -> CurveNetwork:
    """An untrained network, the same each time."""
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


def answering(predictor: Predictor, wires: int = 1, inverted: bool = False) -> Predictor:
    """The predictor with a head that always says the same."""
    head = predictor.network.kind
    for layer in (head.wires, head.inverted):
        torch.nn.init.zeros_(layer.weight)
    head.wires.bias.data = 9.0 * torch.eye(3)[wires]
    torch.nn.init.constant_(head.inverted.bias, 9.0 if inverted else -9.0)
    return predictor


def levels(count: int) -> torch.Tensor:
    """Images (count, 1, 64, 64) as such a network takes them."""
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, 64), 64, k) for k in range(count)]))[:, None].float()
