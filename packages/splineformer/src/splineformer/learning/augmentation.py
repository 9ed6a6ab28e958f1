"""Augmentation: images and curves moved alike, grey levels changed, wires hidden, removed or doubled, curves bent."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from guide3d.geometry.polyline import arc_length, at_length
from guide3d.opencv import cv2
from guide3d.setting_kinds import Grey, Logarithm, Share, settings

_TRIES = 6
_SHORTEST = 0.006  # of the image's side: less of a wire is no curve
_WIRE_CELLS = 7  # round the curve that are filled in when a wire is taken away
_FILL_CELLS = 15
_LEAST, _MOST = 0.004, 0.07  # of the image's side, standard deviation of a curve's perturbation
_NODES = (3, 10)  # random offsets along a curve, at least and at most

Points = NDArray[np.float64]


@settings
class Augmentation:
    """How samples are varied.

    Attributes:
        shift: largest, of the image's side.
        stretch: largest change of size, as the logarithm of a factor.
        gain: contrast is multiplied by exp(±gain).
        offset: largest change of brightness, of 255.
        noise: largest standard deviation, of 255, at the network's size.
        hidden: share of samples over which an opaque bar lies.
        inverted: share with inverted grey levels.
        empty: share whose wire is taken away.
        several: share with a second wire.
        turn_a_pass: rad of turning, all bends together, for which a pass meets a wire once more; 0: each is met once.
    """

    shift: Share = 0.08
    turn_deg: Annotated[float, Interval(ge=0, le=180)] = 8.0
    stretch: Logarithm = 0.12
    gain: Logarithm = 0.5
    offset: Grey = 15.0
    noise: Grey = 4.0
    hidden: Share = 0.2
    inverted: Share = 0.08
    empty: Share = 0.05
    several: Share = 0.05
    turn_a_pass: Annotated[float, Interval(ge=0, le=1000)] = 0.0


def inside(points: Points) -> Points | None:
    """The part of a curve from its tip to where it first leaves the image.

    Args:
        points: (n, 2) shares of the side, tip first.

    Returns:
        (m, 2) points, the last on the border where it leaves; None if less than a stub is left.
    """
    outside: NDArray[np.bool_] = np.any((points < 0) | (points > 1), axis=1)
    if outside[0]:
        return None
    if outside.any():
        first = int(np.argmax(outside))
        a, b = points[first - 1], points[first]
        step = b - a
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.where(step > 0, (1 - a) / step, np.where(step < 0, -a / step, np.inf))
        points = np.vstack([points[:first], a + step * min(float(at.min()), 1.0)])
    return points if len(points) > 1 and arc_length(points)[-1] >= _SHORTEST else None


def at_shares(points: Points, shares: NDArray[np.float64]) -> Points:
    """Points at shares of the length of a curve."""
    return at_length(points, shares * arc_length(points)[-1])


def moved(points: Points, settings: Augmentation, generator: np.random.Generator) -> tuple[Points, NDArray[np.float64]]:
    """Draws a similarity that keeps the tip in the image.

    Args:
        points: (n, 2) shares of the side.

    Returns:
        The moved curve's part inside the image, and the (2, 3) map from old to new places.
    """
    for _ in range(_TRIES):
        turn = np.deg2rad(generator.uniform(-settings.turn_deg, settings.turn_deg))
        size = np.exp(generator.uniform(-settings.stretch, settings.stretch))
        linear = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        offset = 0.5 - linear @ [0.5, 0.5] + generator.uniform(-settings.shift, settings.shift, 2)
        seen = inside(points @ linear.T + offset)
        if seen is not None:
            return seen, np.column_stack([linear, offset])
    return points, np.eye(2, 3)


def warped(images: Tensor, maps: NDArray[np.float64]) -> Tensor:
    """Moves (B, 1, s, s) images by (B, 2, 3) maps of old to new places (shares of the side); black comes in."""
    side = images.shape[-1]
    moved = np.empty(images.shape, np.float32)
    for image, place, way in zip(images.numpy(), moved, maps, strict=True):
        # shares to pixels, of which the first one's centre is 0
        offset = side * way[:, 2] + 0.5 * way[:, :2].sum(axis=1) - 0.5
        cv2.warpAffine(image[0], np.column_stack([way[:, :2], offset]), (side, side), place[0], cv2.INTER_LINEAR)
    return torch.from_numpy(moved)


def without_wire(image: Tensor, points: Points, generator: np.random.Generator) -> Tensor:
    """Fills in the wire of (1, s, s) grey levels from its surroundings, with noise like theirs; (n, 2) shares."""
    side = image.shape[-1]
    length = arc_length(points)[-1]
    dense = at_shares(points, np.linspace(0, 1, max(int(2 * side * length), 2)))
    column, row = np.clip((dense * side).astype(int), 0, side - 1).T
    wire = np.zeros((side, side), np.uint8)
    wire[row, column] = 1
    free = np.float32(1) - cv2.dilate(wire, np.ones((_WIRE_CELLS, _WIRE_CELLS), np.uint8))
    grey = image[0].numpy()
    # beyond the border both sums take nothing, so that their quotient is the mean of what lies inside
    around = _sums(grey * free) / np.maximum(_sums(free), 1e-3)
    # the median of absolute differences: edges of vessels must not count as noise
    spread = 1.2 * float(np.median(np.abs(grey - around)[free > 0]))
    grain = generator.standard_normal((side, side), np.float32)
    return torch.from_numpy(np.where(free > 0, grey, around + np.float32(spread) * grain))[None]


def _sums(values: NDArray[np.float32]) -> NDArray[np.float32]:
    size = _FILL_CELLS, _FILL_CELLS
    return np.asarray(cv2.boxFilter(values, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32)


def shadow(image: Tensor, empty: Tensor) -> Tensor:
    """What a wire lets through: an image over the same without the wire, at most 1."""
    return ((image + 4.0) / (empty + 4.0)).clamp(0.2, 1.0)


def recoloured(images: Tensor, settings: Augmentation, generator: np.random.Generator) -> Tensor:
    """Changes contrast and brightness of (B, 1, s, s) images, lays bars over some, adds noise."""
    batch, side = len(images), images.shape[-1]

    def drawn(low: float, high: float) -> Tensor:
        return torch.from_numpy(generator.uniform(low, high, (batch, 1, 1, 1)).astype(np.float32))

    middle = images.mean(dim=(1, 2, 3), keepdim=True)
    images = (images - middle).mul_(torch.exp(drawn(-settings.gain, settings.gain))).add_(middle)
    images.add_(drawn(-settings.offset, settings.offset))
    for image in images:
        if generator.uniform() < settings.hidden:
            tall, wide = (generator.uniform(0.03, 0.14, 2) * side).astype(int) + 1
            row, column = int(generator.uniform(0, side - tall)), int(generator.uniform(0, side - wide))
            image[0, row : row + tall, column : column + wide] = float(generator.uniform(20, 200))
    seeded = torch.Generator().manual_seed(int(generator.integers(1 << 62)))
    grain = torch.randn(images.shape, generator=seeded)  # in 0.4 of numpy's time
    return images.add_(grain.mul_(drawn(0.0, settings.noise))).clamp_(0.0, 255.0)


def perturbed(points: Tensor, generator: np.random.Generator) -> Tensor:
    """Moves curves off their places smoothly, as predicted ones are, for refinements to learn from.

    The size of the offsets differs from curve to curve. The points are (B, n, 2) shares of the image's side.
    """
    batch, count = points.shape[:2]
    size = np.exp(generator.uniform(np.log(_LEAST), np.log(_MOST), (batch, 1, 1)))
    nodes = int(generator.integers(_NODES[0], _NODES[1] + 1))
    offsets = torch.from_numpy((size * generator.standard_normal((batch, 2, nodes))).astype(np.float32))
    return points + F.interpolate(offsets, count, mode="linear", align_corners=True).transpose(1, 2)
