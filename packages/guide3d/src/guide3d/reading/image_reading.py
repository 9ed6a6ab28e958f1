"""Reads one X-ray image: the wire as an ordered curve, tip first, with its confidence and what is odd about it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.geometry.polyline import Array, arc_length, distances_to
from guide3d.reading.curve_reading import (
    UNSURE,
    CurvesOfImage,
    ImageCurve,
    Prior,
    read_curves,
)
from guide3d.reading.grey_image import READ_PX, SMALLEST_PX, GreyImage, grey_image
from guide3d.reading.ridges import Map

_GUESSED = 0.15  # share of guessed points worth a message
_TIP_UNSURE = 0.3
_CERTAIN_SHARE = 0.25  # of the image's side: certain wire in its negative or at a smaller scale; short lines are common
_FAINT_PX = 120.0  # score below which smaller scales and the negative of an image are tried, too
_WIDE_SCALES = (0.5, 0.375)  # at which wires of 6 and 10 px are about 3 to 4 px wide
_SMALLER = 0.6  # of what is read at a smaller scale counts
_NEAR, _COVERED, _LONGER = 0.008, 0.8, 1.15  # of the side, of a curve's points, and of its length: one that goes on
_BORDER_PX = 20  # a wire that comes in from outside ends so near to the border
_STRAIGHT = 0.01  # largest distance from the chord, as a share of it, of a rod


class Maps(Protocol):
    """Probability maps of one image, (h, w) of 0 to 1 each."""

    @property
    def wire(self) -> Map: ...
    @property
    def catheter(self) -> Map: ...
    @property
    def tip(self) -> Map: ...


class MapReader(Protocol):
    """What makes probability maps of an image, such as `guide3d.reading.maps.Reader`."""

    def maps(self, image: NDArray[np.uint8]) -> Maps:
        """Reads (h, w) uint8."""
        ...


@dataclass(frozen=True, eq=False)
class ImageReading:
    """What an image shows. Pixels are those of the image given, raw or undistorted as it is.

    points_px: (n, 2) the wire, tip first; (0, 2) where there is none
    confidence: (n,) of each point, 0 to 1; low across gaps
    sd_px: (n,) standard deviation of each point across the curve
    tip_confidence: height of the tip map at the first point, 0 to 1
    candidates: readings of the wire, best first, of which this is one
    others: further wires
    notes: what had to be done to the image, as sentences
    """

    points_px: Array
    confidence: Array
    sd_px: Array
    tip_confidence: float
    candidates: list[ImageCurve]
    others: list[ImageCurve]
    notes: list[str] = field(default_factory=list)

    @property
    def messages(self) -> list[str]:
        """What to be careful about, as sentences."""
        return [*self.notes, *_remarks(self)]

    @property
    def found(self) -> bool:
        """Whether there is a wire."""
        return len(self.points_px) > 0

    @property
    def tip_px(self) -> Array | None:
        """(2,) the tip."""
        return self.points_px[0] if self.found else None

    @property
    def overall_confidence(self) -> float:
        """Mean confidence along the curve, 0 without one."""
        return float(self.confidence.mean()) if self.found else 0.0

    @property
    def guessed(self) -> float:
        """Share of guessed points, 0 without a curve."""
        return float((self.confidence < UNSURE).mean()) if self.found else 0.0

    def with_candidate(self, number: int) -> ImageReading:
        """The same image read as its candidate of a number, counted from 0."""
        return _reading(self.candidates, self.others, number, self.notes)


@functools.cache
def shipped_reader() -> MapReader:
    """The network that is shipped with the package, loaded once."""
    from guide3d.reading.maps import Reader

    return Reader.pretrained()


def read(
    image: ArrayLike,
    reader: MapReader | None = None,
    prior: Prior | None = None,
) -> ImageReading:
    """Reads the wire in an X-ray image.

    Args:
        image: (h, w) grey values, dark where X-rays were absorbed: 8 or 16 bits or real numbers, any gain. A negative
            is recognised, and a wire that is too wide for the reader is read at a smaller scale.
        reader: makes the probability maps; None: the one that is shipped.
        prior: the wire a moment before, px of the image.

    Returns:
        The curve; without points, and with a message, where there is no wire.

    Raises:
        ValueError: no image, a coloured or a tiny one, or one without any contrast.
    """
    grey = grey_image(image)
    scales = grey.at_known_scales()
    network = reader or shipped_reader()
    notes = list(grey.messages)
    (seen, curves), *readings = _read_at(scales, network, prior)
    faint = _score(curves) < _FAINT_PX
    if faint or not _is_whole(seen, curves):
        # a wire of a small image may be wide in it, too
        sized = [scales[0], grey] if faint and max(grey.pixels.shape) < READ_PX else scales[:1]
        smaller = [one.resampled(round(share * max(one.pixels.shape))) for one in sized for share in _WIDE_SCALES]
        known = [one.pixels.shape for one in scales]
        smaller = [one for one in smaller if min(one.pixels.shape) >= SMALLEST_PX and one.pixels.shape not in known]
        readings += _read_at(smaller, network, prior)
        wires = [one for one in readings if _is_wide_wire(*one)]
        better = [one for one in wires if _outdoes(*one, curves) or _replaces(*one, seen, curves)]
        seen, curves = better[0] if better else (seen, curves)
    if _score(curves) < _FAINT_PX:
        negatives = [replace(one, pixels=255 - one.pixels, outside=np.zeros_like(one.outside)) for one in scales]
        seen_inverted, other = _read_at(negatives, network, prior)[0]
        if _outdoes(seen_inverted, other, curves):
            seen, curves = seen_inverted, other
            notes.append("the image looks like a negative (wire brighter than its surroundings) and was inverted")
    if curves.candidates:
        points = curves.candidates[0].points_px
        if _is_straight(points) and _at_border(seen, points[0]) and _at_border(seen, points[-1]):
            notes.append("the curve is as straight as a rod and crosses the whole field: look whether it is a wire")
    if curves.candidates and seen.pixels.shape != grey.pixels.shape:
        of, at = (" x ".join(str(side) for side in one.pixels.shape[::-1]) for one in (grey, seen))
        notes.append(f"the image of {of} px was read at {at} px")
    candidates = [_given(seen, curve) for curve in curves.candidates]
    return _reading(candidates, [_given(seen, curve) for curve in curves.others], 0, notes)


def _read_at(
    scales: Sequence[GreyImage], network: MapReader, prior: Prior | None
) -> list[tuple[GreyImage, CurvesOfImage]]:
    """What is read at each scale, first where there is most certain wire by its share of the image's side.

    At smaller scales than the reader knows best, where clutter looks like wires, it counts less.
    """
    readings = []
    for grey in scales:
        before = None if prior is None else Prior(grey.from_given(prior.points_px))
        maps = network.maps(grey.pixels)
        readings.append((grey, read_curves(maps.wire, maps.tip, maps.catheter, grey.outside, before)))
    sides = [max(grey.pixels.shape) for grey, _ in readings]
    weights = [(1.0 if side >= READ_PX else _SMALLER) / side for side in sides]
    order = np.argsort([-_score(curves) * weight for (_, curves), weight in zip(readings, weights, strict=True)])
    return [readings[place] for place in order]


def _outdoes(grey: GreyImage, curves: CurvesOfImage, best: CurvesOfImage) -> bool:
    """Whether far more certain wire is read in another version of an image than was found in the image as it is."""
    return _score(curves) > 2.0 * max(_score(best), 0.0) + _CERTAIN_SHARE * min(grey.pixels.shape)


def _replaces(coarse: GreyImage, other: CurvesOfImage, grey: GreyImage, curves: CurvesOfImage) -> bool:
    """Whether the wire that is read at a smaller scale goes on from what was found of it, or that is hardly a wire."""
    if not curves.candidates:
        return False
    if not _is_seen(curves.candidates[0]):
        return _score(other) > _CERTAIN_SHARE * min(coarse.pixels.shape)
    whole, part = coarse.to_given(other.candidates[0].points_px), grey.to_given(curves.candidates[0].points_px)
    near = distances_to(whole, part) <= _NEAR * max(grey.pixels.shape) * grey.scale
    return bool(near.mean() > _COVERED and arc_length(whole)[-1] > _LONGER * arc_length(part)[-1])


def _is_wide_wire(grey: GreyImage, curves: CurvesOfImage) -> bool:
    """Whether what is read at a smaller scale, where clutter is as thin as wires, is a wire: whole, and no rod."""
    return bool(curves.candidates) and _is_whole(grey, curves) and not _is_straight(curves.candidates[0].points_px)


def _is_whole(grey: GreyImage, curves: CurvesOfImage) -> bool:
    """Whether a curve is seen from its tip to the border of the field."""
    curve = curves.candidates[0]
    return _is_seen(curve) and _at_border(grey, curve.points_px[-1])


def _is_seen(curve: ImageCurve) -> bool:
    """Whether a curve has a tip and is hardly guessed."""
    return bool(curve.tip_confidence >= _TIP_UNSURE and curve.guessed <= _GUESSED)


def _at_border(grey: GreyImage, point: Array) -> bool:
    low = np.maximum(np.rint(point - _BORDER_PX), 0).astype(int)
    high = np.rint(point + _BORDER_PX).astype(int) + 1
    around = grey.outside[low[1] : high[1], low[0] : high[0]]
    return bool(around.any() or around.shape != (2 * _BORDER_PX + 1,) * 2)


def _is_straight(points: Array) -> bool:
    """Whether a curve is as straight as a rod."""
    chord = points[-1] - points[0]
    span = float(np.hypot(*chord))
    away = np.abs((points - points[0]) @ np.array([-chord[1], chord[0]])) / max(span, 1e-9)
    return bool(away.max() <= _STRAIGHT * span)


def _score(curves: CurvesOfImage) -> float:
    return curves.candidates[0].score if curves.candidates else -np.inf


def _given(grey: GreyImage, curve: ImageCurve) -> ImageCurve:
    return replace(curve, points_px=grey.to_given(curve.points_px), sd_px=curve.sd_px * grey.scale)


def _reading(candidates: list[ImageCurve], others: list[ImageCurve], number: int, notes: list[str]) -> ImageReading:
    if not candidates:
        return ImageReading(np.empty((0, 2)), np.empty(0), np.empty(0), 0.0, [], [], notes)
    curve = candidates[number]
    return ImageReading(curve.points_px, curve.confidence, curve.sd_px, curve.tip_confidence, candidates, others, notes)


def _remarks(reading: ImageReading) -> list[str]:
    """Sentences on the curve of an image."""
    if not reading.found:
        return ["no wire was found"]
    remarks = []
    if reading.others:
        count = 1 + len(reading.others)
        remarks.append(f"there are {count} wires: the most certain one is the curve, the others are given too")
    if reading.guessed > _GUESSED:
        remarks.append(f"{reading.guessed:.0%} of the curve is guessed across gaps")
    if reading.tip_confidence < _TIP_UNSURE:
        remarks.append("the tip is uncertain: nothing at the first point looks like one")
    return remarks
