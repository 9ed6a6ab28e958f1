"""Calibration of a reader: its maps of wire and catheter become the shares of pixels that are wire and catheter.

A training that weighs pixels of wire more than others, and the Dice coefficient make maps too sure. A scale and
a shift of the logits, found on random images that were not trained on, put that right (Platt, Probabilistic outputs for
support vector machines, 1999); they become part of the network's last layer.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray

from guide3d.learning.reader.tiles import reader_target
from guide3d.modeling.reader_network import CLASSES, ReaderNetwork, reader_input
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy

CALIBRATED = ("wire", "catheter")  # the tip's map stays a score: most of a blob's pixels are no tip
_PIXELS = 60_000  # of an image
_STEPS = 30


def calibrate(network: ReaderNetwork, fluoroscopy: RandomFluoroscopy, indices: Iterable[int]) -> dict[str, list[float]]:
    """Calibrates a network on the whole images of some indices, in place; returns scale and shift of each map."""
    logits: dict[str, list[NDArray[np.float64]]] = {name: [] for name in CALIBRATED}
    truth: dict[str, list[NDArray[np.float64]]] = {name: [] for name in CALIBRATED}
    network.eval()
    for index in indices:
        drawn = fluoroscopy.image(index)
        seen = torch.from_numpy(reader_input(drawn.image))[None].contiguous(memory_format=torch.channels_last)
        with torch.inference_mode():
            given = network(seen)[0].numpy().reshape(len(CLASSES), -1)
        target = reader_target(drawn).reshape(len(CLASSES), -1)
        chosen = np.random.default_rng(index).integers(0, target.shape[1], _PIXELS)
        for name in CALIBRATED:
            row = CLASSES.index(name)
            logits[name].append(given[row, chosen].astype(float))
            truth[name].append(target[row, chosen].astype(float))
    found = {}
    pixels = network.block_px**2
    for name in CALIBRATED:
        scale, shift = fitted(np.concatenate(logits[name]), np.concatenate(truth[name]))
        row = CLASSES.index(name)
        part = slice(row * pixels, (row + 1) * pixels)
        with torch.no_grad():
            assert network.head.bias is not None
            network.head.weight[part] *= scale
            network.head.bias[part] = network.head.bias[part] * scale + shift
        found[name] = [scale, shift]
    return found


def fitted(logits: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Scale and shift of logits (n,) for which their binary cross-entropy against shares (n,) is smallest."""
    columns = np.column_stack((logits, np.ones(len(logits))))
    answer = np.array([1.0, 0.0])
    for _ in range(_STEPS):  # Newton's method, with a weak pull towards no change
        chance = 1 / (1 + np.exp(-np.clip(columns @ answer, -30, 30)))
        slope = columns.T @ (chance - truth) + 1e-3 * (answer - (1.0, 0.0))
        curve = (columns * (chance * (1 - chance))[:, None]).T @ columns + 1e-3 * np.eye(2)
        step = np.linalg.solve(curve, slope)
        answer = answer - step * min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-9))
    return float(answer[0]), float(answer[1])
