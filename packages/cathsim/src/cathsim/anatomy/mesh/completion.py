"""A phantom of an imported lumen: the user's names, short branches extended, targets, entries, and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.entry import locate_entries
from cathsim.anatomy.extension import DEPTH, LEAST_DEPTH, extend_short_branches
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError, Names
from cathsim.anatomy.phantom import END_CLEARANCE, TARGET_DISTANCE, Phantom, Target
from cathsim.anatomy.vessel_names import AORTA
from cathsim.anatomy.vessel_tree import VesselTree

_ENTRY_CHORD = 0.010  # m of centreline that give an entry its direction: a cut end is often flared or aslant


def imported_phantom(
    tree: VesselTree,
    grid: SignedDistanceGrid,
    report: ImportReport,
    *,
    name: str,
    digest: str,
    extend: bool,
    last_notes: Iterable[str] = (),
) -> Phantom:
    """The phantom of an imported lumen.

    Args:
        report: of the import so far; lengths of ways are missing, and names of vessels that are not in the tree go.
        name, digest: of the phantom.
        extend: whether branches that are cut short are extended.
        last_notes: that follow those on extended branches and targets.

    Raises:
        MeshRefusedError: no branch has a target.
    """
    extended: tuple[str, ...] = ()
    if extend:
        tree, grid, extended = extend_short_branches(tree, grid)
    targets, shortened = propose_targets(tree)
    if not targets:
        advice = "export the branches of the arch, too" if extend else "import it with extend=True"
        raise MeshRefusedError(f"no branch of this vessel is wide and long enough for a wire and a target; {advice}.")
    phantom = Phantom(name, digest, None, tree, grid, targets, locate_entries(tree, _ENTRY_CHORD))
    report = replace(
        report,
        automatic_names={found: final for found, final in report.automatic_names.items() if final in tree},
        way_length={target: round(phantom.way_length(target), 4) for target in phantom.targets},
        notes=(*report.notes, *extended, *shortened, *last_notes),
    )
    return replace(phantom, imported=report)


def final_names(aorta: RoughVessel, automatic: dict[int, str], own: Names) -> dict[int, str]:
    """Automatic names, by the vessels' `id()`, replaced by the user's.

    Args:
        own: a mapping from automatic names, or a list for the aorta's branches from the heart on.

    Raises:
        MeshRefusedError: for a vessel that there is not, a name used twice, or a list of another length.
    """
    if not own:
        return automatic
    if not isinstance(own, Mapping):
        branches = [automatic[id(child)] for child in sorted(aorta.children, key=lambda child: -child.start)]
        if len(own) != len(branches):
            raise MeshRefusedError(
                f"{len(own)} names were given for the {len(branches)} branches of the aorta ({', '.join(branches)}); "
                "give as many, or a mapping."
            )
        own = dict(zip(branches, own, strict=True))
    unknown = sorted(set(own) - set(automatic.values()))
    if unknown:
        raise MeshRefusedError(
            f"names refer to {', '.join(unknown)}, which was not found; found are {', '.join(automatic.values())}."
        )
    if own.get(AORTA, AORTA) != AORTA:
        raise MeshRefusedError("the main vessel keeps its name aorta; give names to its branches only.")
    result = {vessel: own.get(name, name) for vessel, name in automatic.items()}
    if len(set(result.values())) < len(result):
        raise MeshRefusedError(f"names must differ, got {', '.join(result.values())}; give each branch its own.")
    return result


def propose_targets(tree: VesselTree) -> tuple[dict[str, Target], tuple[str, ...]]:
    """Targets by name, one in every branch, and notes on those that were moved or left out."""
    targets, notes = {}, []
    for branch in tree.branches[1:]:
        usual_depth = TARGET_DISTANCE.get(branch.name, DEPTH)
        try:
            ostium = tree.ostium_arc(branch.name)
        except ValueError:  # it never leaves its parent's lumen
            continue
        clearance = END_CLEARANCE if branch.open_end else 0.0
        distance = min(usual_depth, branch.length - clearance - ostium)
        if distance < LEAST_DEPTH:
            notes.append(f"no target in {branch.name}: it is only {1e3 * (branch.length - ostium):.0f} mm long")
            continue
        if distance < min(usual_depth, DEPTH) - 5e-4:
            notes.append(
                f"target {branch.name} lies {1e3 * distance:.0f} mm up its branch instead of {1e3 * usual_depth:.0f}: "
                "the branch is short"
            )
        targets[branch.name] = Target(branch.name, branch.name, branch.point_at(ostium + distance), ostium + distance)
    return targets, tuple(notes)
