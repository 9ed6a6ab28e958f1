"""Is a phantom's lumen fit for a guidewire: open, connected, wide enough, every target within reach?"""

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import wall_distances
from cathsim.anatomy.entry import ENTRY_DEPTH
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.anatomy.wall.thickness import SPECK
from cathsim.lattice.node_set import NodeSet
from cathsim.presets import WIRE_RADIUS


def check_lumen(phantom: Phantom, *, required_radius: float = 2e-3, wire_radius: float = WIRE_RADIUS) -> list[str]:
    """What is wrong with a lumen, by its distance grid.

    It must be connected at a wire's radius, and be as wide as required (m) around the centreline on every target's way.
    """
    grid, aorta = phantom.grid, phantom.tree.root
    free = NodeSet.where(grid.blocks, lambda values: values > wire_radius)
    parts = free.parts()

    def chamber(point: NDArray[np.float64]) -> int:
        index = np.rint((point - grid.origin) / grid.spacing).astype(int)
        node = free.number_at(np.clip(index, 0, np.array(grid.shape) - 1))
        return int(parts[node]) if node >= 0 else -1

    problems = [] if phantom.targets else ["there is no target"]
    ends = {"descending": 3 * ENTRY_DEPTH, "ascending": aorta.length - 3 * ENTRY_DEPTH}
    for name, place in phantom.entries.items():
        across = wall_distances(grid, aorta.point_at([ends[name]]), aorta.tangent_at([ends[name]]))[0].min()
        if float(grid.sample(place.position)) <= wire_radius or across < required_radius:
            problems.append(f"the {name} end is closed or too narrow")
    chambers = np.count_nonzero(np.bincount(parts) >= SPECK)
    if chambers != 1:
        problems.append(f"the lumen falls into {chambers} chambers at the wire's clearance, expected 1")
    home = chamber(phantom.entry().position)
    for name, target in phantom.targets.items():
        if home < 0 or chamber(target.position) != home:
            problems.append(f"target {name} cannot be reached")
        path = way_up(phantom.tree, target.branch, target.arc)
        tangents = np.gradient(path, axis=0)
        tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
        least = wall_distances(grid, path, tangents)[0].min()
        if least < required_radius:
            problems.append(f"the way to {name} narrows to {1e3 * least:.2f} mm of radius")
    return problems


def way_up(tree: VesselTree, branch: str, arc: float) -> NDArray[np.float64]:
    """Points (n, 3) m, about 1 mm apart, along the centrelines from the aorta's lower end to a place in a branch."""
    pieces = []
    for name in reversed(tree.ancestry(branch)):
        start = 0.0 if tree[name].parent is not None else ENTRY_DEPTH
        pieces.append(tree[name].point_at(np.linspace(start, arc, max(int(np.ceil(abs(arc - start) / 1e-3)), 1) + 1)))
        arc = tree[name].parent_arc
    path = np.concatenate(pieces[::-1])
    return path[np.concatenate([[True], np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9])]
