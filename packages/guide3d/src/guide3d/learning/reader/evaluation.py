"""Evaluation of readers on random images, and the calibration of their probabilities."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from guide3d.learning.reader.training import reader_target
from guide3d.modeling.reader_network import CLASSES, ReaderNetwork, reader_input
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.reading.maps import Reader

_NEAR_PX = 4
_TIP_NEAR_PX = 6.0
_HALF = 0.5


CALIBRATED = ("wire", "catheter")  # the tip's map stays a score: most of a blob's pixels are no tip
_PIXELS = 60_000  # of an image
_STEPS = 30


@dataclass(frozen=True)
class ReaderScores:
    """What maps are worth, thresholded at a half.

    Attributes:
        dice: of the wire's map over all images together.
        precision: share of what is marked within 4 px of the wire's mask.
        recall: share of the wires' centre lines within 4 px of a marked pixel.
        catheter_dice: of the catheter's map.
        tip_found: share of the tips with a tip's map above 0.5 within 6 px.
        tip_false: marked tips, further than 6 px from all, an image.
        empty_px: marked pixels an image without wire, mean.
        calibration: mean difference of the wire's map and the truth over ten classes of the map, by their size, where
            the map is above 0.02.
        images: how many.
    """

    dice: float
    precision: float
    recall: float
    catheter_dice: float
    tip_found: float
    tip_false: float
    empty_px: float
    calibration: float
    images: int


def evaluate_reader(reader: Reader, fluoroscopy: RandomFluoroscopy, indices: Iterable[int]) -> ReaderScores:
    """Reads the whole images of some indices."""
    both = marked = true = hit = covered = length = 0.0
    sheath = np.zeros(2)
    tips = hits = false = 0
    empty: list[float] = []
    sums = np.zeros((3, 10))  # of map, truth, and number
    count = 0
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _NEAR_PX + 1, 2 * _NEAR_PX + 1))
    for index in indices:
        drawn = fluoroscopy.image(index)
        maps = reader.maps(drawn.image)
        wire, mask = maps.wire > _HALF, drawn.wire > 127
        both, marked, true = both + (wire & mask).sum(), marked + wire.sum(), true + mask.sum()
        hit += (wire & (cv2.dilate(drawn.wire, disc) > 127)).sum()
        near = cv2.dilate(wire.astype(np.uint8), disc)
        for line in (piece for pieces in drawn.wires for piece in pieces):
            x, y = np.rint(line).astype(int).T
            covered, length = covered + near[y, x].sum(), length + len(line)
        mask = drawn.catheter > 127
        catheter = maps.catheter > _HALF
        sheath += (2 * (catheter & mask).sum(), catheter.sum() + mask.sum())
        if not drawn.wire.any():
            empty.append(float(wire.sum()))
        number, _, _, centres = cv2.connectedComponentsWithStats((maps.tip > _HALF).astype(np.uint8))
        places = centres[1:number]
        apart = np.linalg.norm(places[:, None] - drawn.tips[None], axis=2) if len(drawn.tips) else None
        tips += len(drawn.tips)
        if apart is None:
            false += len(places)
        elif len(places):
            hits += int((apart.min(axis=0) <= _TIP_NEAR_PX).sum())
            false += int((apart.min(axis=1) > _TIP_NEAR_PX).sum())
        wire_mask = maps.wire > 0.02
        part = np.minimum((maps.wire[wire_mask] * 10).astype(int), 9)
        sums[0] += np.bincount(part, maps.wire[wire_mask], 10)
        sums[1] += np.bincount(part, drawn.wire[wire_mask] / 255.0, 10)
        sums[2] += np.bincount(part, minlength=10)
        count += 1
    return ReaderScores(
        dice=float(2 * both / max(marked + true, 1)),
        precision=float(hit / max(marked, 1)),
        recall=float(covered / max(length, 1)),
        catheter_dice=float(sheath[0] / max(sheath[1], 1)),
        tip_found=hits / max(tips, 1),
        tip_false=false / max(count, 1),
        empty_px=float(np.mean(empty)) if empty else 0.0,
        calibration=float(np.abs(sums[0] - sums[1]).sum() / max(sums[2].sum(), 1)),
        images=count,
    )


def calibrate(network: ReaderNetwork, fluoroscopy: RandomFluoroscopy, indices: Iterable[int]) -> dict[str, list[float]]:
    """Calibrates a network on the whole images of some indices, in place; returns scale and shift of each map."""
    logits: dict[str, list[NDArray[np.float64]]] = {name: [] for name in CALIBRATED}
    truth: dict[str, list[NDArray[np.float64]]] = {name: [] for name in CALIBRATED}
    network.eval()
    for index in indices:
        drawn = fluoroscopy.image(index)
        seen = torch.from_numpy(reader_input(drawn.image))[None].contiguous(memory_format=torch.channels_last)
        with torch.inference_mode():
            outputs = network(seen)[0].numpy().reshape(len(CLASSES), -1)
        target = reader_target(drawn).reshape(len(CLASSES), -1)
        chosen = np.random.default_rng(index).integers(0, target.shape[1], _PIXELS)
        for name in CALIBRATED:
            row = CLASSES.index(name)
            logits[name].append(outputs[row, chosen].astype(float))
            truth[name].append(target[row, chosen].astype(float))
    shares = {}
    pixels = network.block_px**2
    for name in CALIBRATED:
        scale, shift = fitted(np.concatenate(logits[name]), np.concatenate(truth[name]))
        row = CLASSES.index(name)
        part = slice(row * pixels, (row + 1) * pixels)
        with torch.no_grad():
            assert network.head.bias is not None
            network.head.weight[part] *= scale
            network.head.bias[part] = network.head.bias[part] * scale + shift
        shares[name] = [scale, shift]
    return shares


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
