"""Access sites of wires: the aorta's ends, the open ends of branches, or any place in the lumen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.point_target import Point, TargetLike, as_target, nearest_branch, require_inside
from cathsim.anatomy.vessel_tree import VesselTree

ENTRY_DEPTH = 2e-3  # m: entries lie this far inside open ends
END_SUFFIX = "_end"  # what lies at the open end of a branch is called after it: "lcca_end"
TOWARDS = " to "  # between an entry's coordinates and the target that its sheath points to
AHEAD = 5e-3  # m: so far ahead of the sheath there must be lumen, where the tip lies at first

EntryLike = str | Sequence[float] | NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Entry:
    """A place where the guidewire comes in: where the sheath ends."""

    name: str  # "descending" (femoral access), "ascending", that of an open end, or a point's coordinates
    position: NDArray[np.float64]  # (3,) m, world frame
    direction: NDArray[np.float64]  # (3,) unit vector along the centreline into the lumen
    amid: bool = False  # whether the sheath reaches here through the lumen, not through an open end


def locate_entries(tree: VesselTree, chord: float = 0.0) -> dict[str, Entry]:
    """Entries "descending" and "ascending" at the first and at the last end of the aorta.

    Args:
        chord: m of centreline that give an entry its direction; 0: the tangent.
    """
    aorta, entries = tree.root, {}
    for name, arc, sign in (("descending", ENTRY_DEPTH, 1.0), ("ascending", aorta.length - ENTRY_DEPTH, -1.0)):
        position = aorta.point_at(arc)
        onward = aorta.point_at(arc + sign * chord) - position if chord else sign * aorta.tangent_at(arc)
        entries[name] = Entry(name, position, onward / np.linalg.norm(onward) if chord else onward)
    return entries


def end_names(tree: VesselTree) -> tuple[str, ...]:
    """Names of the entries at the open ends of branches, such as "lsa_end"."""
    return tuple(branch.name + END_SUFFIX for branch in tree.branches[1:] if branch.open_end)


def end_entry(name: str, tree: VesselTree) -> Entry:
    """The entry just inside the open end of a branch, named as of `end_names`."""
    branch = tree[name.removesuffix(END_SUFFIX)]
    arc = max(branch.length - ENTRY_DEPTH, 0.0)
    return Entry(name, branch.point_at(arc), -branch.tangent_at(arc))


def entry_name(entry: EntryLike, target: TargetLike | None = None) -> str:
    """An entry as text: a name as it is, a point (3,) m as its coordinates, from which it is made again exactly.

    Args:
        target: to which the sheath of a point is to lead; None: to the heart. It changes no text and no name.

    Raises:
        ValueError: it is neither text nor three finite coordinates in metres.
    """
    if isinstance(entry, str):
        return entry
    text = _coordinates(_as_point(entry))
    if target is None:
        return text
    place = as_target(target)
    return text + TOWARDS + (place if isinstance(place, str) else _coordinates(place))


def read_point(name: str) -> tuple[Point, TargetLike | None] | None:
    """Coordinates and the target that the sheath points to from the text of `entry_name`; None for another name.

    Raises:
        ValueError: numbers that are no point in metres.
    """
    place, _, target = name.partition(TOWARDS)
    parts = place.strip("()[] ").split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return None
    goal = target.strip("()[] ").split(",")
    return _as_point(numbers), (None if not target else target.strip() if len(goal) != 3 else _as_point(goal))


def point_entry(
    name: str, point: Point, tree: VesselTree, grid: SignedDistanceGrid, phantom: str, goal: tuple[str, float] | None
) -> Entry:
    """The entry at a point in the lumen, its sheath along the centreline of the vessel there.

    Args:
        name: what it is called.
        point: m, world frame.
        goal: branch, and arc length (m) along it, to which the sheath leads; None: towards the heart.

    Raises:
        ValueError: the point lies outside the lumen, or the sheath would point at a wall within 5 mm.
    """
    require_inside(point, grid, phantom, "entry")
    branch, arc, _ = nearest_branch(point, tree)
    forwards = branch == tree.root.name  # the root ends at the heart, the others begin nearer to it
    if goal is not None:
        chain = tree.ancestry(goal[0])
        if branch in chain:
            deeper = chain[chain.index(branch) + 1 :]
            forwards = (tree[deeper[0]].parent_arc if deeper else goal[1]) > arc
        else:
            forwards = False
    direction = tree[branch].tangent_at(arc) * (1.0 if forwards else -1.0)
    position = np.array(point)
    if grid.sample(position + AHEAD * direction) <= 0:
        raise ValueError(
            f"the sheath that ends at {_coordinates(point)} m would point at the wall of {branch} within "
            f"{1e3 * AHEAD:.0f} mm: move the entry towards the vessel's middle, or along it"
        )
    return Entry(name, position, direction, amid=True)


def _as_point(entry: object) -> Point:
    try:
        place = as_target(entry)
    except ValueError as error:
        raise ValueError(str(error).replace("a target", "an entry", 1)) from None
    assert not isinstance(place, str)
    return place


def _coordinates(point: Point) -> str:
    return ", ".join(repr(coordinate) for coordinate in point)
