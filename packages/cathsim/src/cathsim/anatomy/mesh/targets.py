"""Targets and entries of an imported vessel tree: where the named phantoms have theirs, as far as there is room."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.phantom import END_CLEARANCE, ENTRY_DEPTH, TARGET_DISTANCE, Entry, Target
from cathsim.anatomy.vessel_tree import VesselTree

OTHER_DISTANCE = 0.030  # m beyond the ostium, in branches that the named phantoms do not have
ENTRY_CHORD = 0.010  # m of centreline that give an entry its direction: a cut end is often flared or aslant
_LEAST = 3e-3  # m beyond the ostium: nearer than this a place is no target


def propose_targets(tree: VesselTree) -> tuple[dict[str, Target], tuple[str, ...]]:
    """Proposes a target in every branch.

    Args:
        tree: the vessels.

    Returns:
        Targets by name, and notes on those that had to be moved or left out.
    """
    targets, notes = {}, []
    for branch in tree.branches[1:]:
        wanted = TARGET_DISTANCE.get(branch.name, OTHER_DISTANCE)
        try:
            ostium = tree.ostium_arc(branch.name)
        except ValueError:  # it never leaves its parent's lumen
            continue
        clearance = END_CLEARANCE if branch.open_end else 0.0
        distance = min(wanted, branch.length - clearance - ostium)
        if distance < _LEAST:
            notes.append(f"no target in {branch.name}: it is only {1e3 * (branch.length - ostium):.0f} mm long")
            continue
        if distance < wanted - 1e-9:
            notes.append(
                f"target {branch.name} lies {1e3 * distance:.0f} mm up its branch instead of {1e3 * wanted:.0f}: "
                "the branch is short"
            )
        targets[branch.name] = Target(branch.name, branch.name, branch.point_at(ostium + distance), ostium + distance)
    return targets, tuple(notes)


def propose_entries(tree: VesselTree) -> dict[str, Entry]:
    """Proposes entries at the two ends of the aorta.

    Args:
        tree: the vessels; the root runs from the descending end to the ascending one.

    Returns:
        Entries "descending" and "ascending".
    """
    aorta = tree.root
    entries = {}
    for name, near, far in (
        ("descending", ENTRY_DEPTH, ENTRY_DEPTH + ENTRY_CHORD),
        ("ascending", aorta.length - ENTRY_DEPTH, aorta.length - ENTRY_DEPTH - ENTRY_CHORD),
    ):
        position = aorta.point_at(near)
        way = aorta.point_at(far) - position
        entries[name] = Entry(name, position, way / np.linalg.norm(way))
    return entries
