"""Is a phantom's lumen fit for a guidewire: open, connected, wide enough, every target within reach?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.cross_section import wall_distances
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.entry import ENTRY_DEPTH
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.anatomy.wall.thickness import SPECK
from cathsim.lattice.node_set import NodeSet
from cathsim.presets import WIRE_RADIUS


@dataclass(frozen=True)
class LumenReport:
    """Findings about one lumen."""

    open_ends: dict[str, bool]  # whether each entry lies inside, with an opening of the least radius around it
    components: int  # separate chambers in which the wire's axis can lie
    reachable: dict[str, bool]  # per target, whether it lies in the chamber of the entries
    # per target, m from the centreline to the wall where the way from the default entry is narrowest
    least_radius: dict[str, float]
    required_radius: float  # m, the least that least_radius should be

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each thing that is wrong."""
        found = [f"the {name} end is closed or too narrow." for name, is_open in self.open_ends.items() if not is_open]
        if self.components != 1:
            found.append(f"the lumen falls into {self.components} chambers at the wire's clearance, expected 1.")
        found += [f"target {name} cannot be reached." for name, within in self.reachable.items() if not within]
        found += [
            f"the way to {name} narrows to {radius * 1e3:.2f} mm of radius, {self.required_radius * 1e3:.2f} mm needed."
            for name, radius in self.least_radius.items()
            if radius < self.required_radius
        ]
        if not self.reachable:
            found.append("there is no target.")
        return tuple(found)

    @property
    def valid(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems


def check_lumen(phantom: Phantom, *, required_radius: float = 2e-3, wire_radius: float = WIRE_RADIUS) -> LumenReport:
    """Checks a lumen on its distance grid.

    Args:
        required_radius: m, the least distance from centreline to wall on the way to any target.
        wire_radius: m, clearance at which the lumen must be connected.
    """
    grid = phantom.grid
    free = NodeSet.where(grid.blocks, lambda values: values > wire_radius)
    parts = free.parts()
    chambers = np.count_nonzero(np.bincount(parts) >= SPECK)
    entry = phantom.entry()
    home = _chamber(free, parts, grid, entry.position)

    aorta = phantom.tree.root
    ends = {"descending": 3 * ENTRY_DEPTH, "ascending": aorta.length - 3 * ENTRY_DEPTH}
    open_ends = {}
    for name, place in phantom.entries.items():
        across = _radius_around(grid, aorta.point_at([ends[name]]), aorta.tangent_at([ends[name]]))
        inside = float(grid.sample(place.position)) > wire_radius
        open_ends[name] = inside and float(across.min()) >= required_radius
    reachable, least = {}, {}
    for name, target in phantom.targets.items():
        reachable[name] = home >= 0 and _chamber(free, parts, grid, target.position) == home
        path = centreline_path(phantom.tree, (aorta.name, ENTRY_DEPTH), (target.branch, target.arc))
        tangents = np.gradient(path, axis=0)
        tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
        least[name] = float(_radius_around(grid, path, tangents).min())
    return LumenReport(open_ends, int(chambers), reachable, least, required_radius)


def _chamber(free: NodeSet, parts: NDArray[np.int32], grid: SignedDistanceGrid, point: NDArray[np.float64]) -> int:
    """Number of the chamber that a point lies in, -1 for none."""
    index = np.rint((point - grid.origin) / grid.spacing).astype(int)
    node = free.number_at(np.clip(index, 0, np.array(grid.shape) - 1))
    return int(parts[node]) if node >= 0 else -1


def _radius_around(
    grid: SignedDistanceGrid, points: NDArray[np.float64], tangents: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Smallest distance (n,) m to the wall within the plane across the vessel, found along rays."""
    radius: NDArray[np.float64] = wall_distances(grid, points, tangents)[0].min(axis=0)
    return radius


def centreline_path(tree: VesselTree, start: tuple[str, float], end: tuple[str, float]) -> NDArray[np.float64]:
    """Points (n, 3) m of the centreline graph, about 1 mm apart, between two places: branch and arc length (m) each."""
    first, last = tree.ancestry(start[0]), tree.ancestry(end[0])
    shared = max(i for i in range(min(len(first), len(last))) if first[i] == last[i])

    def climb(chain: tuple[str, ...], arc: float) -> tuple[list[NDArray[np.float64]], float]:
        pieces = []
        for name in reversed(chain[shared + 1 :]):
            pieces.append(_stretch(tree, name, arc, 0.0))
            arc = tree[name].parent_arc
        return pieces, arc

    up, leave = climb(first, start[1])
    down, arrive = climb(last, end[1])
    middle = _stretch(tree, first[shared], leave, arrive)
    path = np.concatenate([*up, middle, *[piece[::-1] for piece in reversed(down)]])
    repeated = np.linalg.norm(np.diff(path, axis=0), axis=1) < 1e-9
    return path[np.concatenate([[True], ~repeated])]


def _stretch(tree: VesselTree, name: str, start: float, end: float) -> NDArray[np.float64]:
    return tree[name].point_at(np.linspace(start, end, max(int(np.ceil(abs(end - start) / 1e-3)), 1) + 1))
