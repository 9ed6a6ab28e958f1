"""Wires that mark single beads of a calibration cube: thin lines found in the image, classified by their form.

A single straight wire, two parallel ones and a bent one are the marks that a reference file calls single, double and
circle. Lead letters are as dark as the beads and are left out; so is the rim of the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guide3d.calibration.bead_cube import Attenuation, Beads, attenuation
from guide3d.image_filters import blurred, white_tophat
from guide3d.opencv import cv2

KINDS = ("single", "double", "circle")
_WIDTH_PX = 6  # half of the widest line
_FAINT, _CLEAR, _LETTER = 0.05, 0.08, 0.45  # attenuation of a wire at least, at its clearest, and at most
_RIM_PX = 16
_SHORTEST_PX = 18


@dataclass(frozen=True, eq=False)
class WireMark:
    """One mark.

    kind: "single", "double" or "circle"
    pixels: (n, 2) px that it covers, raw as found
    """

    kind: str
    pixels: np.ndarray


@dataclass(frozen=True, eq=False)
class _Line:
    pixels: np.ndarray
    centre: np.ndarray
    along: np.ndarray
    length: float
    width: float

    @classmethod
    def of(cls, pixels: np.ndarray) -> _Line:
        centre = pixels.mean(axis=0)
        axes = np.linalg.eigh(np.cov((pixels - centre).T))[1]
        width, length = np.ptp((pixels - centre) @ axes, axis=0) + 1
        return cls(pixels, centre, axes[:, 1], float(length), float(width))

    @property
    def straight(self) -> bool:
        return self.width < max(0.35 * self.length, 9.0)


def find_marks(image: np.ndarray | Attenuation, beads: Beads) -> list[WireMark]:
    """Find the wire marks of a cube image, in no order of meaning.

    Args:
        image: (h, w), grey, raw; or its attenuation.
        beads: The beads found in it, which hide the wires behind them.
    """
    light = image if isinstance(image, Attenuation) else attenuation(image)
    lines = [_Line.of(pixels) for pixels in _thin(light, beads)]
    lines = [line for line in lines if line.length >= _SHORTEST_PX]
    lines = _joined(lines, beads)
    marks: list[WireMark] = []
    paired: set[int] = set()
    for i, a in enumerate(lines):
        if not a.straight:
            marks.append(WireMark("circle", a.pixels))
            continue
        for j in range(i + 1, len(lines)):
            b = lines[j]
            if not b.straight or {i, j} & paired:
                continue
            apart = b.centre - a.centre
            across = abs(apart @ [-a.along[1], a.along[0]])
            mean = (a.length + b.length) / 2
            parallel = abs(a.along @ b.along) > 0.9 and abs(a.length - b.length) < 0.5 * mean
            if parallel and across > 0.3 * mean and np.linalg.norm(apart) < 1.7 * mean:
                marks.append(WireMark("double", np.concatenate([a.pixels, b.pixels])))
                paired |= {i, j}
                break
    marks += [WireMark("single", a.pixels) for i, a in enumerate(lines) if a.straight and i not in paired]
    return marks


def _thin(light: Attenuation, beads: Beads) -> list[np.ndarray]:
    """Pixels (n, 2) of each thin, faint structure away from beads and rim."""
    dark = light.dark
    ridge = white_tophat(blurred(dark, 1.0), 2 * _WIDTH_PX)
    # a square's distance: 0 outside the field and the image
    inside = cv2.distanceTransform(np.pad(light.field, 1).astype(np.uint8), cv2.DIST_C, 3)
    free = np.asarray(inside[1:-1, 1:-1] > _RIM_PX)
    for (x0, y0), radius in zip(beads.centres_px, beads.radii_px[:, 0], strict=True):
        reach = radius + 3
        low = np.maximum(np.floor([x0 - reach, y0 - reach]).astype(int), 0)
        high = np.ceil([x0 + reach, y0 + reach]).astype(int) + 1
        part = free[low[1] : high[1], low[0] : high[0]]
        y, x = np.mgrid[low[1] : low[1] + part.shape[0], low[0] : low[0] + part.shape[1]]
        part &= np.hypot(x - x0, y - y0) > reach
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(((ridge > _FAINT) & free).astype(np.uint8), connectivity=8)
    marks = []
    for number, (left, top, wide, high, _) in enumerate(boxes.tolist()[1:], 1):
        box = np.s_[top : top + high, left : left + wide]
        own = labels[box] == number
        clear = (ridge[box] > _CLEAR) & own
        if own.sum() < 40 or clear.sum() < 10 or np.percentile(dark[box][own], 90) > _LETTER:
            continue
        y, x = np.nonzero(own)
        marks.append(np.column_stack([x + left, y + top]).astype(float))
    return marks


def _joined(lines: list[_Line], beads: Beads) -> list[_Line]:
    """Lines whose parts a bead cuts apart, put together."""
    lines = list(lines)
    for i in range(len(lines)):
        for j in range(len(lines) - 1, i, -1):
            a, b = lines[i], lines[j]
            if not (a.straight and b.straight):
                continue
            gaps = np.linalg.norm(a.pixels[:, None] - b.pixels[None], axis=2)
            ends = np.unravel_index(gaps.argmin(), gaps.shape)
            middle = (a.pixels[ends[0]] + b.pixels[ends[1]]) / 2
            off = (
                np.linalg.norm(beads.centres_px - middle, axis=1) - beads.radii_px[:, 0]
                if len(beads)
                else np.array([np.inf])
            )
            both = _Line.of(np.concatenate([a.pixels, b.pixels]))
            if gaps.min() < 35 and off.min() < 8 and both.straight and both.length > 0.9 * (a.length + b.length):
                lines[i] = both
                del lines[j]
    return lines
