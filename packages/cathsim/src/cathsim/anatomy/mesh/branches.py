"""Which ways through a lumen make which vessel: a main vessel, its branches, and theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length

_SAME_FORK = 6e-3  # m: forks nearer to each other than this are one
_APART = 0.9  # of the wider's radius between two ways: where they have been nearer, they run in one lumen
_OWN_TAKE_OFF = 1.3  # of the wider's radius above the aorta's wall: where two lumens part below, each has its own
_SHORT_TRUNK = 0.4  # of its radius: a trunk that parts so near to the aorta is none
_LONG_WITHIN = 3.0  # of the aorta's radius there, that a branch's way may run within its lumen
_ONE_LUMEN = 0.8  # of the wider's radius: ways nearer to each other than this run in one lumen

Array = NDArray[np.float64]
Voxels = NDArray[np.int64]


@dataclass(eq=False)
class RoughVessel:
    """One vessel of a lumen, before it has a name or a smooth centreline."""

    points: Array  # (n, 3) m, from the place where its way leaves the parent's
    depth: Array  # (n,) m, distance to the wall along it
    end: int | None  # number of the end it leads to, negative where vessels meet in a ring, None where it forks
    children: list[RoughVessel] = field(default_factory=list)  # vessels that leave it, in the order in which they do
    start: float = 0.0  # m along the parent's points at which it leaves them
    from_fork: bool = False  # whether it goes on from the parent's last point
    clear: int = 0  # its first point that was seen to lie outside the parent's lumen; 0: nobody has looked

    @property
    def every(self) -> list[RoughVessel]:
        """It and all that leaves it."""
        return [self] + [vessel for child in self.children for vessel in child.every]

    @property
    def ends(self) -> list[int]:
        """Numbers of all ends that it and what leaves it lead to."""
        own = [] if self.end is None else [self.end]
        return own + [end for child in self.children for end in child.ends]

    @property
    def length(self) -> float:
        """m, from where it leaves the parent's way."""
        return float(arc_length(self.points)[-1])

    @property
    def tip(self) -> Array:
        """(3,) m, the furthest of its own and its children's last points, seen from its start."""
        tips = [self.points[-1], *[child.tip for child in self.children]]
        return np.mean(tips if self.end is None else tips[:1], axis=0)

    @property
    def radius(self) -> float:
        """m, median distance to the wall over the first 15 mm outside the parent."""
        outside = self.outside
        arc = arc_length(self.points)
        near = (arc >= arc[outside]) & (arc <= arc[outside] + 15e-3)
        return float(np.median(self.depth[near]))

    @property
    def outside(self) -> int:
        """First point that lies outside the parent's lumen; depths shrink from there to the vessel's own."""
        if self.from_fork:
            return 0
        shrinking = np.flatnonzero(arc_length(self.points) >= self.depth[0])
        return max(int(shrinking[0]) if len(shrinking) else len(self.points) - 1, self.clear)


@dataclass(frozen=True, eq=False)
class _Ways:
    """Ways from one root, as `build_vessels` takes them."""

    ways: Sequence[Voxels]
    points: Sequence[Array]
    depths: Sequence[Array]

    def shared(self, a: int, b: int) -> int:
        """How many voxels two ways have in common."""
        n = min(len(self.ways[a]), len(self.ways[b]))
        apart = np.flatnonzero((self.ways[a][:n] != self.ways[b][:n]).any(axis=1))
        return int(apart[0]) if len(apart) else n

    def _groups(self, numbers: list[int], beyond: int) -> list[list[int]]:
        """Numbers whose ways go on together beyond a voxel."""
        groups: list[list[int]] = []
        for number in numbers:
            arc = arc_length(self.points[number])
            limit = float(arc[min(beyond, len(arc) - 1)]) + _SAME_FORK
            least = int(np.searchsorted(arc, limit))
            for group in groups:
                if self.shared(number, group[0]) > least:
                    group.append(number)
                    break
            else:
                groups.append([number])
        return groups

    def _build(self, numbers: list[int], start: int) -> RoughVessel:
        sides: list[tuple[list[int], int]] = []
        current, stop = numbers, None
        while len(current) > 1:
            fork = min(self.shared(current[0], other) for other in current[1:])
            parts = self._groups(current, fork)
            if len(parts) == 1:  # they part within what counts as one fork
                parts = [[number] for number in current]
            if max(map(len, parts)) == 1:
                stop = fork
                break
            parts.sort(key=len)
            sides += [(part, fork) for part in parts[:-1]]
            current = parts[-1]
        return self.assemble(current, start, stop, sides)

    def assemble(
        self, current: list[int], start: int, stop: int | None, sides: list[tuple[list[int], int]]
    ) -> RoughVessel:
        """A vessel along some ways that are one.

        Args:
            current: their numbers.
            start: their first voxel that is the vessel's.
            stop: the voxel where they part into vessels that go on from it; None: it leads to an end.
            sides: numbers of further ways that leave it together, and the voxel where.
        """
        first = current[0]
        last = len(self.points[first]) if stop is None else max(stop, start + 2)
        arc = arc_length(self.points[first])
        vessel = RoughVessel(
            self.points[first][start:last], self.depths[first][start:last], first if stop is None else None
        )
        for part, fork in sides:
            child = self._build(part, max(fork - 1, 0))
            child.start = float(arc[max(fork - 1, 0)] - arc[start])
            vessel.children.append(child)
        if stop is not None:
            for number in current:
                child = self._build([number], last - 1)
                child.start, child.from_fork = vessel.length, True
                vessel.children.append(child)
        vessel.children.sort(key=lambda child: child.start)
        return vessel


def build_vessels(ways: Sequence[Voxels], points: Sequence[Array], depths: Sequence[Array], main: int) -> RoughVessel:
    """Turns ways from one root into vessels; returns the main one.

    Args:
        ways: for each end the voxels (n, 3) of its way; ways share voxels until they part.
        points: for each end the same places (n, 3) m.
        depths: for each end the distances (n,) m to the wall.
        main: number of the end that the main vessel leads to.
    """
    every = _Ways(ways, points, depths)
    others = [number for number in range(len(ways)) if number != main]
    leaves = {number: every.shared(number, main) for number in others}
    trunk = RoughVessel(points[main], depths[main], main)
    # Ways that leave the main vessel together and part again within its lumen are branches of their own.
    families: list[list[int]] = []
    for number in sorted(others, key=lambda n: leaves[n]):
        for family in families:
            fork = every.shared(number, family[0])
            if fork > leaves[number] and _beside(trunk, points[number][: fork + 1][-1]) > 0:
                family.append(number)
                break
        else:
            families.append([number])
    aorta = every.assemble([main], 0, None, [(family, min(leaves[n] for n in family)) for family in families])
    _join_common_origins(aorta)
    _part_short_trunks(aorta)
    _move_forks(aorta)
    _lead_out(aorta)
    return aorta


def _move_forks(vessel: RoughVessel) -> None:
    """Lets trunks go on to where the lumens that they part into are apart; ways to them keep to their sides before."""
    for child in vessel.children:
        _move_forks(child)
    daughters = sorted((child for child in vessel.children if child.from_fork), key=lambda child: -child.radius)
    if len(daughters) < 2:
        return
    arcs = [arc_length(daughter.points) for daughter in daughters]
    step = 0.5e-3
    first = [min((c.start for c in d.children if not c.from_fork), default=d.length) for d in daughters]
    most = min(0.6 * min(arc[-1] for arc in arcs), *first)
    at = np.arange(step, most, step)
    along = [
        np.stack([np.interp(at, arc, d.points[:, k]) for k in range(3)], axis=1)
        for arc, d in zip(arcs, daughters, strict=True)
    ]
    depth = [np.interp(at, arc, d.depth) for arc, d in zip(arcs, daughters, strict=True)]
    gaps = np.min(
        [
            np.linalg.norm(a - along[0], axis=1) / np.maximum(d, depth[0])
            for a, d in zip(along[1:], depth[1:], strict=True)
        ],
        axis=0,
    )
    apart = np.flatnonzero(gaps > _APART)
    count = int(apart[0]) if len(apart) else 0
    if count < 2:
        return
    vessel.points = np.concatenate([vessel.points, np.mean(along, axis=0)[:count]])
    vessel.depth = np.concatenate([vessel.depth, np.max(depth, axis=0)[:count]])
    length = vessel.length
    for daughter, arc in zip(daughters, arcs, strict=True):
        cut = int(np.searchsorted(arc, at[count - 1]))
        daughter.points = np.concatenate([vessel.points[-1:], daughter.points[cut:]])
        daughter.depth = np.concatenate([vessel.depth[-1:], daughter.depth[cut:]])
        for child in daughter.children:
            child.start = max(child.start - float(arc[cut]), 0.0)
        daughter.start = length


def _part_short_trunks(aorta: RoughVessel) -> None:
    """Makes the daughters of a trunk that parts right above the aorta's wall branches of the aorta."""
    children = []
    for trunk in aorta.children:
        daughters = [child for child in trunk.children if child.from_fork]
        if not daughters or len(daughters) < len(trunk.children) or not _part_at_once(daughters, trunk, aorta):
            children.append(trunk)
            continue
        children += parted(trunk)
    aorta.children = sorted(children, key=lambda child: child.start)


def parted(trunk: RoughVessel) -> list[RoughVessel]:
    """The vessels that a trunk forks into, as branches of its parent that begin where the trunk does."""
    daughters = [child for child in trunk.children if child.from_fork]
    for daughter in daughters:
        daughter.points = np.concatenate([trunk.points, daughter.points[1:]])
        daughter.depth = np.concatenate([trunk.depth, daughter.depth[1:]])
        for child in daughter.children:
            child.start += trunk.length
        daughter.start, daughter.from_fork = trunk.start, False
    return daughters


def _part_at_once(daughters: Sequence[RoughVessel], trunk: RoughVessel, aorta: RoughVessel) -> bool:
    """Whether all lumens that a trunk parts into are apart from each other right above the aorta's wall."""
    radius = float(trunk.depth[leaving(trunk, aorta)])
    widest = max(daughters, key=lambda daughter: daughter.radius)
    for daughter in daughters:
        apart = next((point for point in daughter.points if _beside(widest, point) > 0), None)
        if daughter is not widest and (apart is None or _beside(aorta, apart) > _SHORT_TRUNK * radius):
            return False
    return True


def _join_common_origins(aorta: RoughVessel) -> None:
    """Makes a branch that is still one lumen with a wider one where both leave the aorta a branch of that one.

    Ways part early in a wide trunk, since each keeps to its own side of it.
    """
    by_width = sorted(aorta.children, key=lambda child: -child.radius)
    for number, narrow in enumerate(by_width):
        for wide in by_width[:number]:
            if wide not in aorta.children:
                continue
            first, second = leaving(narrow, aorta), leaving(wide, aorta)
            gap = float(np.linalg.norm(narrow.points[first] - wide.points[second]))
            if gap < _ONE_LUMEN * max(narrow.depth[first], wide.depth[second]):
                if _take_off_by_itself(narrow, wide, aorta):
                    break
                narrow.start = float(arc_length(wide.points)[second])
                aorta.children.remove(narrow)
                wide.children.append(narrow)
                wide.children.sort(key=lambda child: child.start)
                break
    aorta.children.sort(key=lambda child: child.start)


def _take_off_by_itself(narrow: RoughVessel, wide: RoughVessel, aorta: RoughVessel) -> bool:
    """Leads a branch's way straight to the aorta where it parts from a wider one right above the aorta's wall.

    A way prefers the wide mouth of its neighbour to a narrow one of its own. Returns False, and changes nothing, where
    the two have a trunk of more than its radius in common.
    """
    fork_index = next((i for i, point in enumerate(narrow.points) if _beside(wide, point) > 0), None)
    if fork_index is None:
        return False
    place = narrow.points[fork_index]
    if _beside(aorta, place) > _OWN_TAKE_OFF * wide.depth[leaving(wide, aorta)]:
        return False
    _lead_straight(narrow, fork_index, aorta)
    return True


def _lead_straight(vessel: RoughVessel, point_index: int, aorta: RoughVessel) -> None:
    """Lets a vessel leave the aorta on the straight line to one of its points, and be that point's from there on."""
    place = vessel.points[point_index]
    foot = int(np.argmin(np.linalg.norm(aorta.points - place, axis=1)))
    share = np.linspace(0.0, 1.0, max(int(np.linalg.norm(place - aorta.points[foot]) / 1e-3), 2), endpoint=False)
    back = aorta.points[foot] + share[:, None] * (place - aorta.points[foot])
    depths = aorta.depth[foot] + share * (vessel.depth[point_index] - aorta.depth[foot])
    shorter = float(arc_length(vessel.points)[point_index]) - float(np.linalg.norm(place - aorta.points[foot]))
    vessel.points = np.concatenate([back, vessel.points[point_index:]])
    vessel.depth = np.concatenate([depths, vessel.depth[point_index:]])
    vessel.start = float(arc_length(aorta.points)[foot])
    for child in vessel.children:
        child.start = max(child.start - shorter, 0.0)


def _lead_out(aorta: RoughVessel) -> None:
    """Corrects ways that part from the aorta's long before they leave its lumen, as those of wide short branches do."""
    for child in aorta.children:
        exit_node = leaving(child, aorta)
        foot = int(np.argmin(np.linalg.norm(aorta.points - child.points[exit_node], axis=1)))
        if exit_node < len(child.points) - 2 and arc_length(child.points)[exit_node] > _LONG_WITHIN * aorta.depth[foot]:
            _lead_straight(child, exit_node, aorta)
    aorta.children.sort(key=lambda child: child.start)


def _beside(vessel: RoughVessel, point: Array) -> float:
    """How far a point lies outside a vessel, m; negative inside."""
    distance = np.linalg.norm(vessel.points - point, axis=1)
    nearest = int(np.argmin(distance))
    return float(distance[nearest] - vessel.depth[nearest])


def leaving(vessel: RoughVessel, parent: RoughVessel) -> int:
    """First point of a vessel outside its parent's lumen."""
    return next((i for i, point in enumerate(vessel.points) if _beside(parent, point) > 0), len(vessel.points) - 1)


def led_into(vessel: RoughVessel, side: RoughVessel) -> RoughVessel:
    """Makes a vessel go on as one of its side branches; what it was beyond leaves it there, and is returned."""
    arc = arc_length(vessel.points)
    at = int(np.clip(np.searchsorted(arc, side.start), 1, len(arc) - 3))
    later = [child for child in vessel.children if child is not side and child.start > side.start]
    beyond = RoughVessel(vessel.points[at:], vessel.depth[at:], vessel.end, later, float(arc[at]))
    for child in later:
        child.start = max(child.start - float(arc[at]), 0.0)
    for child in side.children:
        child.start += float(arc[at])
    earlier = [child for child in vessel.children if child is not side and child not in later]
    vessel.points = np.concatenate([vessel.points[: at + 1], side.points[1:]])
    vessel.depth = np.concatenate([vessel.depth[: at + 1], side.depth[1:]])
    vessel.end, vessel.children = side.end, [*earlier, beyond, *side.children]
    return beyond


def part_at(vessel: RoughVessel, side: RoughVessel) -> None:
    """Makes a vessel end where a side branch leaves it, and part into what it was beyond and that branch."""
    arc = arc_length(vessel.points)
    at = int(np.clip(np.searchsorted(arc, side.start), 1, len(arc) - 3))
    later = [child for child in vessel.children if child is not side and child.start > side.start]
    for child in later:
        child.start -= float(arc[at])
    beyond = RoughVessel(vessel.points[at:], vessel.depth[at:], vessel.end, later, float(arc[at]), from_fork=True)
    side.start, side.from_fork = float(arc[at]), True
    vessel.points, vessel.depth, vessel.end = vessel.points[: at + 1], vessel.depth[: at + 1], None
    vessel.children = [child for child in vessel.children if child not in later]
    vessel.children.append(beyond)


def turned(vessel: RoughVessel, rotation: Array, offset: Array) -> RoughVessel:
    """A vessel and its children in another frame, by a rotation (3, 3) and an offset (3,) m added after it."""
    children = [turned(child, rotation, offset) for child in vessel.children]
    return replace(vessel, points=vessel.points @ rotation.T + offset, children=children)
