"""Targets in an imported vessel tree: where the named phantoms have theirs, nearer where a branch is short."""

from __future__ import annotations

from .phantom import END_CLEARANCE, TARGET_DISTANCE, Target
from .vessel_tree import VesselTree

OTHER_DISTANCE = 0.030  # m beyond the ostium, in branches that the named phantoms do not have
_LEAST = 5e-3  # m beyond the ostium: nearer than this a place is no target


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
