"""Velocity of the blood in a phantom, by place and time.

The flow enters at the aortic root, is shared among the open ends, and follows the centrelines; at every moment each
vessel carries its share of what the heart ejects. Within a section the profile is Poiseuille's or Womersley's.
"""

from __future__ import annotations

import ctypes
import functools
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.blood.flow import BloodFlow, descending_shares, outlet_shares
from cathsim.blood.womersley import profile_table
from cathsim.contact.native import BloodStruct, address, library

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

Array = NDArray[np.float64]

NODE_SPACING = 2e-3  # m between the nodes that name the vessel a point lies in
SAMPLE_SPACING = 1e-3  # m between centreline samples
REACH = 4e-3  # m: nodes this far outside the lumen still belong to its vessel
PHASES, RADII, COLUMNS = 96, 12, 65  # of the velocity table
CORE = 0.5  # share of the radius within which a parent's flow does not yet turn into its branch


class BloodField:
    """Velocity of the blood in a phantom, by place and time.

    Args:
        flow: what the heart drives through them.

    Attributes:
        shares: of the open ends, by branch.
        inlet_area: of the aortic root, m^2.
        peak_flow: largest flow at the root, m^3/s.
    """

    def __init__(self, phantom: Phantom, flow: BloodFlow) -> None:
        self.phantom, self.flow, tree = phantom, flow, phantom.tree
        flow_shares = dict(flow.shares)
        if flow.descending_share is not None:
            flow_shares |= descending_shares(tree, flow.descending_share, flow_shares)
        self.shares = outlet_shares(tree, flow_shares)
        self._carried = {branch.name: self._through(branch.name) for branch in tree}
        inlet = float(tree.root.radius[-1])
        self.inlet_area = math.pi * inlet**2
        radii = [float(r) for branch in tree for r in (branch.radius.min(), branch.radius.max())]
        self._first: dict[str, tuple[int, Array]] = {}  # of each branch: its first sample, arc length of its samples
        self._radii = np.linspace(min(radii), max(radii), RADII)
        table, at_inlet = self._table(inlet)
        # The largest velocity at the root is given; the flow that goes with it follows from the profile.
        per_peak = float(at_inlet.max())
        self.peak_flow = flow.peak_velocity * self.inlet_area / per_peak
        table = np.concatenate([table, table[:1]]) * self.peak_flow
        self._arrays = self._sections(), self._nodes(), np.ascontiguousarray(table)
        samples, (nodes, origin), table = self._arrays
        self.struct = BloodStruct(
            size=tuple(nodes.shape),
            origin=tuple(origin),
            inverse=1.0 / NODE_SPACING,
            nodes=nodes.ctypes.data,
            samples=samples.ctypes.data,
            table=table.ctypes.data,
            phases=len(table) - 1,
            rows=table.shape[1],
            columns=table.shape[2],
            frequency=flow.heart_rate if flow.waveform == "pulsatile" else 0.0,
            start=flow.phase,
        )

    def _through(self, name: str) -> float:
        """Share of the flow that a branch takes from its parent."""
        downstream = sum(self._through(child.name) for child in self.phantom.tree if child.parent == name)
        if name == self.phantom.tree.root.name:
            return self.shares[name] + downstream
        return self.shares.get(name, 0.0) + downstream

    def _table(self, inlet: float) -> tuple[Array, Array]:
        """Velocity over the peak of the mean, for the table's radii, and for the inlet's."""
        flow = self.flow
        if flow.waveform == "steady":
            parabola = 2.0 * (1.0 - np.linspace(0.0, 1.0, COLUMNS))
            return np.broadcast_to(parabola, (1, RADII, COLUMNS)), parabola
        physics = {"frequency": flow.heart_rate, "density": flow.density, "viscosity": flow.viscosity}
        table = profile_table([*self._radii, inlet], PHASES, COLUMNS, womersley=flow.profile == "womersley", **physics)
        return table[:, :-1], table[:, -1]

    def carried(self, branch: str, arc: ArrayLike) -> Array:
        """Share (...,) of the root's flow in a branch at arc lengths (...,) m; linear over the width of an ostium."""
        tree, arc = self.phantom.tree, np.asarray(arc, dtype=np.float64)
        vessel, is_root = tree[branch], branch == tree.root.name
        carried = np.full(arc.shape, self.shares[branch] if is_root else self._carried[branch])
        for child in tree:
            if child.parent == branch and (is_root or child.parent_arc < vessel.length - 1e-9):
                half = float(child.radius[0])
                beyond = np.clip((arc - child.parent_arc + half) / (2 * half), 0.0, 1.0)
                # the root is numbered against the stream
                carried = carried + (1 if is_root else -1) * self._carried[child.name] * beyond
        return carried

    def _sections(self) -> Array:
        """Centreline samples of all branches, rows as in blood.h. Shape (n, 9)."""
        rows: list[Array] = []
        count = 0
        for branch in self.phantom.tree:
            arc = np.linspace(0.0, branch.length, round(branch.length / SAMPLE_SPACING) + 1)
            radius = branch.radius_at(arc)
            share = self.carried(branch.name, arc) / (math.pi * radius**2)
            downstream = -1.0 if branch.parent is None else 1.0
            line = (radius - self._radii[0]) / max(self._radii[-1] - self._radii[0], 1e-12) * (RADII - 1)
            columns = (branch.point_at(arc), downstream * branch.tangent_at(arc), share, radius**-2.0, line)
            self._first[branch.name] = count, arc
            rows.append(np.column_stack(columns))
            count += len(arc)
        return np.ascontiguousarray(np.concatenate(rows))

    def _nodes(self) -> tuple[NDArray[np.int32], Array]:
        """Nearest centreline sample of the vessel that each node of the coarse grid lies in, and the grid's origin."""
        from scipy.spatial import cKDTree

        low, high = self.phantom.bounds
        origin = low - REACH
        size = np.ceil((high + REACH - origin) / NODE_SPACING).astype(int) + 1
        axes = [origin[k] + NODE_SPACING * np.arange(size[k]) for k in range(3)]
        layers: list[tuple[NDArray[np.int64], Array]] = []
        for x in axes[0]:  # one after the other: all points of a large box at once are much memory
            points = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 3)
            chosen = np.flatnonzero(self.phantom.grid.sample(points) > -REACH)
            layers.append((chosen + len(layers) * len(points), points[chosen]))
        near, points = (np.concatenate(parts) for parts in zip(*layers, strict=True))
        node = np.full(len(near), -1, np.int32)
        lies_at = {}  # distance from each branch's axis over its radius
        owner = np.full(len(near), -1)
        for number, branch in enumerate(self.phantom.tree):
            first, arc = self._first[branch.name]
            centres, along = branch.point_at(arc), branch.tangent_at(arc)
            _, nearest = cKDTree(centres).query(points)
            offset = points - centres[nearest]
            ahead = np.einsum("ij,ij->i", offset, along[nearest])
            across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - ahead**2, 0.0))
            place = across / branch.radius_at(arc[nearest])
            # a vessel ends where others continue it, and begins where it leaves its parent
            before = (nearest == 0) & (ahead < 0) if branch.parent is not None else False
            behind = (nearest == len(arc) - 1) & (ahead > 0) if not branch.open_end else False
            place[before | behind] = np.inf
            lies_at[number] = place
            takes = owner < 0
            for other, rival in lies_at.items():
                if other != number:
                    is_parent = self.phantom.tree.branches[other].name == branch.parent
                    # the parent's flow turns into the branch in a funnel before the ostium
                    limit = (rival - CORE) / (1.0 - CORE) if is_parent else rival
                    takes |= (owner == other) & (place < limit)
            takes &= np.isfinite(place)
            owner[takes], node[takes] = number, first + nearest[takes]
        grid = np.full(tuple(size), -1, np.int32)
        grid.reshape(-1)[near] = node
        return grid, origin

    def velocity(self, points: ArrayLike, time: float = 0.0) -> Array:
        """Velocity (..., 3) m/s of the blood at points (..., 3) m and a time (s); zero outside the vessels."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), got {points.shape}")
        velocities = np.empty_like(points)
        library().cathsim_blood_velocities(
            ctypes.byref(self.struct), points.size // 3, address(points), ctypes.c_double(time), address(velocities)
        )
        return velocities

    def flow_rate(self, time: ArrayLike) -> Array:
        """Flow (...,) m^3/s at the aortic root at times (...,) s; positive out of the heart."""
        table = self._arrays[2][:, 0]
        flows = np.asarray(np.trapezoid(table, np.linspace(0.0, 1.0, COLUMNS), axis=1))
        turns = self.struct.start + self.struct.frequency * np.asarray(time, dtype=np.float64)
        return np.interp(np.mod(turns, 1.0) * (len(flows) - 1), np.arange(len(flows)), flows)

    @property
    def cardiac_output(self) -> float:
        """Mean flow at the aortic root, m^3/s."""
        period = 1.0 / self.flow.heart_rate
        return float(self.flow_rate(np.arange(PHASES) / PHASES * period).mean())


@functools.lru_cache(maxsize=64)
def blood_field(phantom: Phantom, flow: BloodFlow) -> BloodField:
    """The field of a flow in a phantom, shared by every simulation of both."""
    return BloodField(phantom, flow)
