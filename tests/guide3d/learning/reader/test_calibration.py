"""Calibration: too sure maps become right, and the network's last layer carries it."""

from __future__ import annotations

import numpy as np
import torch

from guide3d.learning.reader.evaluation import calibrate, fitted
from guide3d.modeling.reader_network import ReaderNetwork
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings


def test_scale_and_shift_are_found() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(-1, 3, 40_000)
    truth = (rng.random(40_000) < 1 / (1 + np.exp(-(0.5 * logits - 1.2)))).astype(float)
    scale, shift = fitted(logits, truth)
    assert abs(scale - 0.5) < 0.02
    assert abs(shift + 1.2) < 0.05


def test_the_last_layer_carries_it() -> None:
    torch.manual_seed(0)
    network = ReaderNetwork(widths=(8, 8)).eval()
    images = torch.randn(1, 2, 32, 32)
    with torch.no_grad():
        before = network(images)
        found = calibrate(network, RandomFluoroscopy(FluoroscopySettings(image_px=128), seed=1), range(2))
        after = network(images)
    for row, name in enumerate(("wire", "catheter")):
        scale, shift = found[name]
        torch.testing.assert_close(after[:, row], before[:, row] * scale + shift, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(after[:, 2], before[:, 2])
