"""Vessels and what leaves them as nested parts, and the changes by which parts become vessels of their own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.mesh.branches import RoughVessel

RIGHT = "right"  # the right subclavian and carotid artery where their trunk is cut before it parts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Subtree:
    """A vessel from some place on, with all that leaves it from there on."""

    vessel: RoughVessel
    start: float  # m along the vessel's points
    split: float  # m along the vessel's points at which its daughters part, or its end
    daughters: tuple[Subtree, ...]  # two or more, or none

    @property
    def leaves(self) -> tuple[Subtree, ...]:
        """All parts without daughters."""
        return tuple(leaf for d in self.daughters for leaf in d.leaves) if self.daughters else (self,)

    @property
    def inner(self) -> tuple[Subtree, ...]:
        """All parts below it."""
        return tuple(one for d in self.daughters for one in (d, *d.inner))

    @cached_property
    def radius(self) -> float:
        """m, median distance to the wall from its start, outside the parent, to where it parts."""
        return float(np.median(self.vessel.depth[self._own]))

    @property
    def points(self) -> Array:
        """(n, 3) m from its start, outside the parent, to where it parts."""
        return self.vessel.points[self._own]

    @property
    def length(self) -> float:
        """m, from its start, outside the parent, to where it parts."""
        return float(arc_length(self.points)[-1])

    @property
    def _own(self) -> slice:
        arc = arc_length(self.vessel.points)
        first = self.vessel.outside if self.start == 0 else int(np.searchsorted(arc, self.start))
        last = int(np.searchsorted(arc, self.split, side="right"))
        return slice(min(first, len(arc) - 1, max(last - 1, 0)), max(last, 1))

    @cached_property
    def main_leaf(self) -> Subtree:
        """The widest of its leaves."""
        return max(self.leaves, key=lambda leaf: leaf.radius)

    @property
    def tip(self) -> Array:
        """(3,) m, where its main leaf ends."""
        return self.main_leaf.vessel.points[-1]

    @cached_property
    def base(self) -> Array:
        """(3,) m, where it leaves its parent's lumen, or parts from its sister."""
        arc = arc_length(self.vessel.points)
        index = self.vessel.outside if self.start == 0 else int(np.searchsorted(arc, self.start))
        return self.vessel.points[min(index, len(arc) - 1)]


Named = list[tuple[RoughVessel, tuple[Subtree, ...]]]


def subtree(vessel: RoughVessel, start: float = 0.0, side: int = 0) -> Subtree:
    """The nested parts of a vessel, from its first point on."""
    sides = [child for child in vessel.children if not child.from_fork]
    forks = [child for child in vessel.children if child.from_fork]
    if side < len(sides):
        child = sides[side]
        return Subtree(vessel, start, child.start, (subtree(child), subtree(vessel, child.start, side + 1)))
    return Subtree(vessel, start, vessel.length, tuple(subtree(child) for child in forks))


def choices(part: Subtree, count: int) -> Iterator[tuple[Subtree, ...]]:
    """All ways to pick `count` parts of a subtree of which none holds another; of one, the whole."""
    if count == 1:
        yield (part,)
        return
    limits = [range(min(len(d.leaves), count) + 1) for d in part.daughters]
    for shares in product(*limits):
        if sum(shares) == count:
            picked = [choices(d, share) for d, share in zip(part.daughters, shares, strict=True) if share]
            for combination in product(*(list(p) for p in picked)):
                yield tuple(one for group in combination for one in group)


def rebuilt(part: Subtree, names: Mapping[Subtree, str], *, from_fork: bool = False) -> tuple[RoughVessel, Named]:
    """Makes vessels of a part so that every named part is one vessel, from where it leaves its trunk to its main end.

    Args:
        part: of which vessels are made; it may be named, or hold named parts.
        names: of parts of which none holds another.

    Returns:
        The first vessel; and for each named part, and each trunk of named parts, the vessel and those parts.
    """
    named_vessels: Named = []
    pieces: list[Subtree] = []
    children: list[RoughVessel] = []
    length = 0.0
    piece: Subtree | None = part
    own = part if part in names else None
    within = [named for named in names if named is part or named in part.inner]
    while piece is not None:
        pieces.append(piece)
        length += piece.split - piece.start
        onward = _onward(piece, piece if own is not None else None, names)
        for daughter in piece.daughters:
            if daughter is onward:
                continue
            child, more = rebuilt(daughter, names, from_fork=onward is None)
            child.start = length
            children.append(child)
            named_vessels += more
        piece = onward
    points, depth = _joined(pieces)
    last = pieces[-1]
    vessel = RoughVessel(
        points, depth, None if last.daughters else last.vessel.end, children, part.vessel.start, from_fork
    )
    if part.start == 0:  # the same vessel, whoever knows it
        part.vessel.__dict__.update(vessel.__dict__)
        vessel = part.vessel
    arc = float(arc_length(points)[-1])
    for child in children:
        child.start = arc if child.from_fork else min(child.start, arc)
    if within:
        named_vessels.insert(0, (vessel, tuple(within)))
    return vessel, named_vessels


def _onward(piece: Subtree, own: Subtree | None, names: Mapping[Subtree, str]) -> Subtree | None:
    """The daughter that a vessel goes on as; None where it ends, or parts into vessels of their own."""
    if not piece.daughters:
        return None
    if own is not None:
        return next(d for d in piece.daughters if piece.main_leaf in d.leaves)
    leading = next((d for d in piece.daughters for named in (d, *d.inner) if names.get(named) == RIGHT), None)
    if leading is not None:  # the right side's trunk keeps its name beyond a left carotid
        return leading
    counts = [sum(named is d or named in d.inner for named in names) for d in piece.daughters]
    if not any(counts):  # as it was: it goes on beyond side branches and ends in forks
        return piece.daughters[-1] if piece.daughters[-1].vessel is piece.vessel else None
    if sum(count > 0 for count in counts) == 1:
        return piece.daughters[int(np.argmax(counts))]
    several = [d for d, count in zip(piece.daughters, counts, strict=True) if count > 1]
    return several[0] if len(several) == 1 else None


def _joined(pieces: list[Subtree]) -> tuple[Array, Array]:
    """Points (n, 3) m and depths (n,) m along successive parts."""
    points, depth = [], []
    for number, piece in enumerate(pieces):
        arc = arc_length(piece.vessel.points)
        first = int(np.searchsorted(arc, piece.start - 1e-9))
        last = int(np.searchsorted(arc, piece.split - 1e-9))
        span = slice(min(first, len(arc) - 2) + (number > 0), min(last, len(arc) - 1) + 1)
        points.append(piece.vessel.points[span])
        depth.append(piece.vessel.depth[span])
    return np.concatenate(points), np.concatenate(depth)
