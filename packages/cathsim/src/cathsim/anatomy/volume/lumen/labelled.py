"""The lumen of labelled vessels in the patient's axes: level, distance to its wall, paths, flat ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.lumen import OUTSIDE, PADDING
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.volume.files.reading import LabelVolume
from cathsim.anatomy.volume.labels.family import find_family
from cathsim.anatomy.volume.lumen.ends import Tip, flat_end
from cathsim.anatomy.volume.lumen.graph import LumenGraph
from cathsim.anatomy.volume.lumen.lattice import BlockLattice, connected, signed_distance
from cathsim.anatomy.volume.lumen.paths import VesselPaths, find_paths, narrow_places, rough_vessels
from cathsim.anatomy.volume.lumen.smoothing import VesselField, ways_to_lost
from cathsim.anatomy.volume.lumen.union import FlatEnd, Union, unite
from cathsim.anatomy.wall.thickness import fill_chambers, thicken_between_lumens

_BATCH = 400_000  # nodes worked on at once
_LEAST_RADIUS, _LEAST_SPACINGS = 1.5e-3, 1.5  # m, and spacings of the lattice, to which vessels are kept open
# m, and spacings of the lattice, from the lumen's nodes within which voxels belong to it: smoothing leaves some out
_AT_WALL, _AT_WALL_SPACINGS = 1.75e-3, 1.2
_AT_FACE = 1.5  # spacings, and a voxel, between a vessel's tip and the volume's face that cuts it

Array = NDArray[np.float64]
Field = NDArray[np.float32]


class LabelledLumen:
    """The lumen of labelled vessels, on a lattice along the patient's axes.

    Args:
        volume: the labels.
        resolution: m between the lattice's nodes.

    Raises:
        MeshRefusedError: the labels are noise, or no vessel hangs on the aorta.
    """

    def __init__(self, volume: LabelVolume, resolution: float) -> None:
        self.volume = volume
        self.notes: list[str] = []
        box, self.family = find_family(volume.vessels, volume.names, volume.spacing)
        self.box = box
        self.voxels = {number: int(np.count_nonzero(box == number)) for number in self.family.order}
        self.union: Union = unite(box, self.family, volume.spacing, volume.first, volume.shape, resolution)
        self.notes += self.family.notes
        # from the box's axes to the patient's
        self.turn = volume.frame @ volume.affine[:3, :3] / volume.spacing
        lumen = np.concatenate([_inner_points(field) for field in self.union.fields.values()]) @ self.turn.T
        self.offset = -(lumen.min(axis=0) + lumen.max(axis=0)) / 2
        self.lattice = BlockLattice.around(lumen + self.offset, resolution, -OUTSIDE, PADDING)

    @property
    def world_offset(self) -> Array:
        """(3,) m that is added to points of the file's world, turned to the patient's axes."""
        return self.offset - self.volume.frame @ self.volume.affine[:3, 3]

    def build(self) -> tuple[SignedDistanceGrid, RoughVessel, dict[int, str], dict[str, tuple[float, float]]]:
        """The distance grid, the vessels' paths with names by `id()`, and volumes (m^3) in voxels and in the grid."""
        level, which, inside = self.level()
        if self.rejoin(inside):
            level, which, inside = self.level()
        rows = np.flatnonzero(inside)
        depth = np.zeros_like(level)
        depth[rows] = signed_distance(self.lattice, level, rows)
        paths = self.paths(depth, which, inside)
        if paths.against_axes:
            self.notes.append(
                "the branches' order puts the heart at the other end of the aorta than the file's axes of the patient: "
                "the order counts; check the axes"
            )
        self.notes += [
            f"{self.family.names[number]} ends where {1e3 * length:.0f} mm of it begin that are thin as a bridge to "
            "another vessel is"
            for number, length in paths.thin.items()
        ]
        self.open_narrow(paths)
        first, ends, cut = self.flatten(paths)
        self.notes += [f"{name} is cut off by the volume's edge" for name in cut]
        level, which, inside = self.level()
        distance = signed_distance(self.lattice, level)
        aorta, names = rough_vessels(self.paths(distance, which, inside), ends, first, self.ostia())
        main = [self.family.names[number] for number in paths.main]
        if len(main) > 1:
            self.notes.append(f"the aorta's course begins in {main[0]}, by which a wire comes in")
        lost = [name for name in self.family.names.values() if name not in names.values() and name not in main]
        self.notes += [f"{name} is left out: no way leads into it" for name in lost]
        shape = np.array(self.lattice.shape)
        within = (self.lattice.nodes < shape).all(axis=1)
        nodes = self.lattice.nodes[within]
        grid = SignedDistanceGrid.from_nodes(
            nodes, distance[within], self.lattice.shape, self.lattice.origin, self.lattice.spacing
        )
        grid = fill_chambers(thicken_between_lumens(grid))
        distance[within] = grid.blocks.at(nodes)
        return grid, aorta, names, self._volumes(distance, which)

    def _volumes(self, distance: Field, which: NDArray[np.uint8]) -> dict[str, tuple[float, float]]:
        """Volumes (m^3) of every vessel's voxels, and of its part of the lumen."""
        spacing = self.lattice.spacing
        filled = np.clip(distance / np.float32(spacing) + np.float32(0.5), 0, 1)
        near = np.flatnonzero(filled > 0)
        voxels = np.rint(self.to_box(self.lattice.points(self.lattice.nodes[near])) / self.volume.spacing).astype(int)
        inside = ((voxels >= 0) & (voxels < self.box.shape)).all(axis=1)
        labels = which[near]
        parts = self.box[tuple(voxels[inside].T)]
        labels[inside] = np.where(parts > 0, parts, labels[inside])
        held = np.bincount(labels, weights=filled[near], minlength=256) * spacing**3
        return {
            name: (self.voxels[number] * self.volume.voxel_volume, float(held[number]))
            for number, name in self.family.names.items()
        }

    def to_patient(self, points: Array) -> Array:
        """Points (..., 3) m of the box's axes in the patient's."""
        return points @ self.turn.T + self.offset

    def to_box(self, points: Array) -> Array:
        """Points (..., 3) m of the patient's axes in the box's."""
        return (points - self.offset) @ np.linalg.inv(self.turn).T

    def level(self) -> tuple[Field, NDArray[np.uint8], NDArray[np.bool_]]:
        """Level (n,) m of all nodes, the vessel of each, and which belong to the lumen."""
        count = len(self.lattice.nodes)
        level, which = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.uint8)
        for some in np.array_split(np.arange(count), count // _BATCH + 1):
            level[some], which[some] = self.union.level(self.to_box(self.lattice.points(self.lattice.nodes[some])))
        root = self.family.order[0]
        start = int(np.argmax(np.where(which == root, level, -1.0)))
        inside = connected(self.lattice, level, start)
        level[(level > 0) & ~inside] *= -1
        return level, which, inside

    def ostia(self) -> dict[int, Array]:
        """(3,) m, the middle of every vessel's take-off."""
        return {number: self.to_patient(link.ostium.mean(axis=0)) for number, link in self.family.links.items()}

    def paths(self, depth: Field, which: NDArray[np.uint8], inside: NDArray[np.bool_]) -> VesselPaths:
        """Where the vessels run and end."""
        graph = LumenGraph.of(self.lattice, depth, inside)
        return find_paths(graph, which[graph.rows], self.family, self.ostia())

    @property
    def least(self) -> float:
        """m, the radius to which vessels are kept open."""
        return max(_LEAST_RADIUS, _LEAST_SPACINGS * self.lattice.spacing)

    def rejoin(self, inside: NDArray[np.bool_]) -> bool:
        """Opens the way to parts of vessels that smoothing has parted from the rest; whether there are any."""
        any_lost = False
        for number in self.family.order:
            mask = self.box == number
            ways = ways_to_lost(mask, self._in_lumen(mask, inside), self.volume.spacing)
            if not ways:
                continue
            any_lost = True
            self._open(number, np.concatenate(ways))
            self.notes.append(
                f"{self.family.names[number]} is kept open to {1e3 * self.least:.1f} mm of radius where its labels "
                "hang together by a thin step only"
            )
        return any_lost

    def _in_lumen(self, mask: NDArray[np.bool_], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which voxels (nx, ny, nz) of a vessel lie in the lumen, or at its wall."""
        from scipy.spatial import cKDTree

        voxels = np.argwhere(mask)
        points = self.to_patient(voxels * self.volume.spacing)
        rows = self.lattice.number(np.rint((points - self.lattice.origin) / self.lattice.spacing).astype(np.int64))
        near = (rows >= 0) & inside[rows]
        rest = np.flatnonzero(~near)
        if len(rest):
            reach = max(_AT_WALL, _AT_WALL_SPACINGS * self.lattice.spacing)
            low, high = points[rest].min(axis=0) - reach, points[rest].max(axis=0) + reach
            lumen = self.lattice.points(self.lattice.nodes[inside])
            lumen = lumen[((lumen >= low) & (lumen <= high)).all(axis=1)]
            if len(lumen):
                away, _ = cKDTree(lumen).query(points[rest], distance_upper_bound=reach)
                near[rest] = np.isfinite(away)
        result = np.zeros_like(mask)
        result[tuple(voxels[near].T)] = True
        return result

    def _open(self, number: int, places: Array) -> None:
        """Keeps a vessel open about places (n, 3) m of the box's axes."""
        self.union.channel = self.least
        before = self.union.channels.get(number, np.empty((0, 3)))
        self.union.channels[number] = np.concatenate([before, places])

    def open_narrow(self, paths: VesselPaths) -> None:
        """Keeps vessels open where coarse voxels or closed gaps leave them narrower than a wire needs."""
        least = self.least
        ostia = self.ostia()
        for number, tip in {**paths.tips, **paths.forks}.items():
            begin = paths.graph.nearest(ostia[number], paths.which == number)
            places, depth = narrow_places(paths, number, begin, tip, least)
            if len(places):
                self._open(number, self.to_box(places))
                self.notes.append(
                    f"{self.family.names[number]} is kept open to {1e3 * least:.1f} mm of radius where the labels "
                    f"leave {1e3 * depth:.1f}"
                )

    def flatten(self, paths: VesselPaths) -> tuple[FlatEnd, dict[int, FlatEnd], list[str]]:
        """Cuts all ends flat: the main path's first, the others by vessel, and which the volume's edge cuts."""
        root = self.family.order[0]
        faces = []
        for axis, place, sign in self.union.faces:
            point = np.zeros(3)
            point[axis] = place
            near = float(self.volume.spacing[axis]) + _AT_FACE * self.lattice.spacing
            faces.append((self.to_patient(point), self.turn[:, axis] * sign, near))
        ostia = self.ostia()
        below = paths.main[0]
        tips = {below if below != root else -1: flat_end(paths, root, paths.start, paths.last, faces)}
        tips[root] = flat_end(paths, root, paths.last, paths.start, faces)
        for number, node in paths.tips.items():
            begin = paths.graph.nearest(ostia[number], paths.which == number)
            if begin != node:
                tips[number] = flat_end(paths, number, node, begin, faces)
        for number, tip in tips.items():
            if not tip.flat:
                self.union.ends.setdefault(root if number == -1 else number, []).append(self._in_box(tip))
        first = tips.pop(below if below != root else -1)
        cut = ["the aorta's lower end" if below == root else self.family.names[below]] if first.cut else []
        cut += [self.family.names[n] if n != root else "the ascending aorta" for n, tip in tips.items() if tip.cut]
        return first.end, {number: tip.end for number, tip in tips.items()}, cut

    def _in_box(self, tip: Tip) -> FlatEnd:
        end = tip.end
        return FlatEnd(self.to_box(end.base), np.linalg.inv(self.turn) @ end.normal, end.beyond, end.radius)


def _inner_points(field: VesselField) -> Array:
    return field.origin + np.argwhere(field.values > 0) * field.spacing
