"""Which two of a lumen's ends are the aorta's: those between which the tube is the largest.

An opening's radius does not tell: a branch that is cut where it widens into the arch may end wider than the aorta.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length

_CALIBRE = 0.5  # of a way's mean radius: narrower parts of it are no part of the tube
_UNSURE = 0.7  # of the tube's volume that another pair of ends has, and of its radius that the other's own part has

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a way: steps (n,) m and distances to the wall (n,) m along it."""

    steps: Array
    depth: Array

    def __add__(self, other: _Part) -> _Part:
        return _Part(np.concatenate([self.steps, other.steps]), np.concatenate([self.depth, other.depth]))

    @property
    def radius(self) -> float:
        """Mean distance to the wall, m; 0 of a part without length."""
        length = float(self.steps.sum())
        return float(self.steps @ self.depth) / length if length else 0.0

    @property
    def volume(self) -> float:
        """Length times radius squared, m^3, where it is of the way's calibre."""
        wide = self.depth >= _CALIBRE * self.radius
        return float(self.steps[wide] @ self.depth[wide] ** 2)


def aortic_ends(points: Sequence[Array], depths: Sequence[Array]) -> tuple[int, int, tuple[int, ...]]:
    """Chooses two ends by the ways from the first end.

    Args:
        points: (n, 3) m of each way, from end 0 to end 1, 2 and so on; ways are shared until they part.
        depths: (n,) m, distances to the wall along them.

    Returns:
        Numbers of both ends, and of others that could be one of them.
    """
    ways = [_Part(np.diff(arc_length(p), prepend=0.0), d) for p, d in zip(points, depths, strict=True)]

    def beyond(a: int, b: int) -> tuple[_Part, _Part]:
        """The parts of the ways to two ends beyond what they share, which is nothing of end 0."""
        if a == 0:
            return _Part(np.zeros(0), np.zeros(0)), ways[b - 1]
        n = min(len(points[a - 1]), len(points[b - 1]))
        apart = np.flatnonzero((points[a - 1][:n] != points[b - 1][:n]).any(axis=1))
        fork = int(apart[0]) if len(apart) else n
        first, second = (_Part(ways[k - 1].steps[fork:], ways[k - 1].depth[fork:]) for k in (a, b))
        return first, second

    def tube(a: int, b: int) -> _Part:
        first, second = beyond(*sorted((a, b)))
        return first + second

    pairs = list(itertools.combinations(range(len(points) + 1), 2))
    volumes = {pair: tube(*pair).volume for pair in pairs}
    best = max(pairs, key=lambda pair: volumes[pair])
    aorta = tube(*best)
    unsure = []
    for other in set(range(len(points) + 1)) - set(best):
        for kept, left in (best, best[::-1]):
            # what the way to the other end has of its own, beside that from one of the aorta's ends to the other
            own = _own_part(tube(kept, other), aorta, tube(left, other))
            large = volumes[tuple(sorted((kept, other)))] >= _UNSURE * volumes[best]  # type: ignore[index]
            if large and own >= _UNSURE * aorta.radius:
                unsure.append(other)
    return *best, tuple(sorted(set(unsure)))


def _own_part(to_other: _Part, aorta: _Part, between: _Part) -> float:
    """Mean radius, m, of the part of two ways to one end that the aorta does not have.

    Of three ways between three ends each part lies on two of them: half the sum of two less the third is one part.
    """
    lengths = [float(part.steps.sum()) for part in (to_other, between, aorta)]
    areas = [float(part.steps @ part.depth) for part in (to_other, between, aorta)]
    length, area = (0.5 * (one + two - three) for one, two, three in (lengths, areas))
    return area / length if length > 0 else 0.0
