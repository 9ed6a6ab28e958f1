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

_CALIBRE = 0.6  # of a way's mean radius: narrower parts of it are no part of the tube
_AS_LARGE = 0.97  # of the largest tube's size
_END = 0.6  # of the radius of the aorta's end: a vessel that ends narrower is none
_UNSURE = 0.7  # of the tube's size that another pair of ends has, and of its radius that the other's own part has

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
    def size(self) -> float:
        """Volume times radius, m^4 over pi, where it is of the way's calibre: a long artery has volume, too."""
        wide = self.depth >= _CALIBRE * self.radius
        return float(self.steps[wide] @ self.depth[wide] ** 3)


def aortic_ends(
    points: Sequence[Array], depths: Sequence[Array], radii: Sequence[float]
) -> tuple[int, int, tuple[int, ...]]:
    """Chooses two ends by the ways from the first end; of tubes that are as large, the one with the wider ends.

    Args:
        points: (n, 3) m of each way, from end 0 to end 1, 2 and so on; ways are shared until they part.
        depths: (n,) m, distances to the wall along them.
        radii: m, of all ends.

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
    sizes = {pair: tube(*pair).size for pair in pairs}
    largest = max(sizes.values())  # a coronary artery leaves the aorta next to its end
    best = max((pair for pair in pairs if sizes[pair] >= _AS_LARGE * largest), key=lambda p: radii[p[0]] + radii[p[1]])
    aorta = tube(*best)
    unsure = []
    for other in set(range(len(points) + 1)) - set(best):
        for fixed_end, replaced_end in (best, best[::-1]):
            to_other, between = tube(fixed_end, other), tube(replaced_end, other)
            own, shared = _common(to_other, between, aorta), _common(to_other, aorta, between)
            large = sizes[tuple(sorted((fixed_end, other)))] >= _UNSURE * sizes[best]  # type: ignore[index]
            if large and own >= _UNSURE * shared and radii[other] >= _END * radii[replaced_end]:
                unsure.append(other)
    return *best, tuple(sorted(set(unsure)))


def _common(one: _Part, two: _Part, third: _Part) -> float:
    """Mean radius, m, of what two of the three ways between three ends have in common; 0 where that has no length."""
    lengths = [float(part.steps.sum()) for part in (one, two, third)]
    areas = [float(part.steps @ part.depth) for part in (one, two, third)]
    length, area = (0.5 * (a + b - c) for a, b, c in (lengths, areas))
    return area / length if length > 0 else 0.0
