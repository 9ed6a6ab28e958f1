"""Costs of going on from one piece of a wire to the next: length and emptiness of the gap, and how it has to bend."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2
from guide3d.reading.ridges import Map, Pieces

_SAMPLES = 12  # of a gap


# What a link costs, in px of certain wire.
_LONGEST = 0.166  # of a gap, as a share of the image's longer side
_EMPTY_PER_PX = 0.25  # cost of a px of gap without any probability
_BENDING_PX = 120.0  # cost of bending energy, which has the unit 1/px: a turn by one radian over n px has energy 1 / n
# additional cost of a rad by which a link turns more than `_KINK_FROM`, if its gap is shorter than `_KINK_PX`
_KINK = 80.0
_KINK_FROM = 1.2
_KINK_PX = 16.0
_UNSEEN_TURN = 20.0  # additional cost of a rad beyond `_UNSEEN_FROM` by which a link turns, to and fro, in a longer gap
_UNSEEN_FROM = 0.6
_SHORTEST_PX = 12.0  # gaps count as this long when they bend
_DEAREST = 120.0  # links that cost more are not tried
_MOST = 8  # links that are tried from each end


class Link(NamedTuple):
    """An end that may be entered next, what it costs, and px of the gap without any probability."""

    end: int
    cost: float
    empty_px: float


def link_costs(pieces: Pieces, probability: Map, toll: Array | None = None) -> list[list[Link]]:
    """Computes what it costs to leave a piece at one end and to enter another one.

    Args:
        probability: (h, w) of 0 to 1, smoothed: weak evidence makes a gap cheaper.
        toll: (2 k,) what it costs in addition to go on from each end, such as one at the border; None: nothing.

    Returns:
        Of each end by which a path leaves: links, cheapest first.
    """
    count = len(pieces.ends)
    toll = np.zeros(count) if toll is None else toll
    links: list[list[Link]] = [[] for _ in range(count)]
    if count < 4:
        return links
    leave, enter = np.nonzero(_near(pieces, _LONGEST * max(probability.shape)))
    gap = pieces.ends[enter] - pieces.ends[leave]
    length = np.hypot(*gap.T)
    out, into = pieces.outward[leave], -pieces.outward[enter]
    bending = bending_energy(out, into, gap, _SHORTEST_PX) * _BENDING_PX
    # a wire that crosses another goes on; it does not kink and go on as the other
    sharp = np.abs(_turn(out, into)) - _KINK_FROM
    short = np.clip(2.0 - length / _KINK_PX, 0.0, 1.0)
    bending += _KINK * np.maximum(sharp, 0.0) * short
    unseen = np.abs(_turn(out, gap)) + np.abs(_turn(gap, into)) - _UNSEEN_FROM
    bending += _UNSEEN_TURN * np.maximum(unseen, 0.0) * (1.0 - short)
    near = bending < _DEAREST
    leave, enter, length, bending = leave[near], enter[near], length[near], bending[near]
    if not len(leave):
        return links
    places = bridges(pieces.ends[leave], pieces.ends[enter], out[near], into[near], _SAMPLES)
    x, y = np.moveaxis(np.asarray(places, np.float32), -1, 0)
    seen = np.asarray(cv2.remap(probability, x, y, cv2.INTER_LINEAR), float).mean(axis=1)
    empty = length * (1.0 - np.minimum(2.0 * seen, 1.0))
    cost = bending + toll[leave] + toll[enter] + _EMPTY_PER_PX * empty
    for k in np.argsort(cost):
        if cost[k] < _DEAREST and len(links[leave[k]]) < _MOST:
            links[leave[k]].append(Link(int(enter[k]), float(cost[k]), float(empty[k])))
    return links


def bending_energy(out: Array, into: Array, gap: Array, shortest_px: float) -> Array:
    """Computes the bending energy (n,) 1/px of cubic curves across gaps: the integral of their squared curvature.

    Args:
        out, into: (n, 2) unit directions of travel before and after the gap.
        gap: (n, 2) px from its start to its end.
        shortest_px: least length that a gap counts as.
    """
    length = np.hypot(*gap.T)
    mean = out + into
    size = np.hypot(*mean.T)
    mean = np.where(size[:, None] > 0.1, mean / np.maximum(size, 1e-9)[:, None], 0.0)
    # across a few px the direction from end to end is noise of the skeleton
    trust = (length / (length + 0.5 * shortest_px))[:, None]
    chord = trust * gap / np.maximum(length, 1e-9)[:, None] + (1.0 - trust) * mean
    first, second = _turn(out, chord), _turn(chord, into)
    return np.asarray(4.0 * (first**2 - first * second + second**2) / np.maximum(length, shortest_px))


def _turn(a: Array, b: Array) -> Array:
    return np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))


def _near(pieces: Pieces, longest_px: float) -> NDArray[np.bool_]:
    ends = pieces.ends
    near = np.hypot(*(ends[:, None] - ends[None]).transpose(2, 0, 1)) <= longest_px
    piece = np.arange(len(ends)) // 2
    return np.asarray(near & (piece[:, None] != piece[None]))


def bridges(start: Array, end: Array, out: Array, into: Array, count: int) -> Array:
    """Draws cubic curves across gaps; those between directions of an arc are nearly that arc.

    Args:
        start, end: (n, 2) px.
        out, into: (n, 2) unit directions of travel there.
        count: points of each curve.

    Returns:
        (n, count, 2) px, at the middles of equal steps of the parameter.
    """
    gap = end - start
    length = np.maximum(np.hypot(*gap.T), 1e-9)
    chord = gap / length[:, None]
    turn = 0.5 * (np.abs(_turn(out, chord)) + np.abs(_turn(chord, into)))
    speed = (length / np.cos(0.5 * np.minimum(turn, 2.0)) ** 2)[:, None]
    t = (np.arange(count) + 0.5) / count
    basis = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2)
    parts = (start, out * speed, end, into * speed)
    return np.sum([value[None, :, None] * part[:, None, :] for value, part in zip(basis, parts, strict=True)], axis=0)
