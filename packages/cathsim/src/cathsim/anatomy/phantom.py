"""A phantom: vessel tree, lumen, targets and entries of one anatomy, with its geodesic fields and meshes."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.distance_grid import LatticeField, SignedDistanceGrid
from cathsim.anatomy.entry import (
    END_SUFFIX,
    Entry,
    EntryLike,
    end_entry,
    end_names,
    entry_name,
    point_entry,
    read_point,
)
from cathsim.anatomy.generator.recipe import Recipe
from cathsim.anatomy.geodesic import geodesic_field, graph_distance
from cathsim.anatomy.point_target import (
    BranchDepths,
    Point,
    TargetLike,
    as_target,
    depth_in_branch,
    drawn_point,
    nearest_branch,
    require_inside,
    target_name,
)
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.lifetime_cache import KeptWhileUsed

if TYPE_CHECKING:
    import trimesh

    from cathsim.anatomy.mesh.report import ImportReport

# Distance beyond the ostium (for rsa and rcca: beyond the bifurcation of the trunk), m.
TARGET_DISTANCE = {"bca": 0.030, "lcca": 0.040, "lsa": 0.040, "rcca": 0.020, "rsa": 0.020}
END_DISTANCE = 0.010  # m from a branch's open end to the target there
END_CLEARANCE = 5e-3  # m between a target and the open end of its branch
_NAMED_KEPT, _POINTS_KEPT = 1, 4  # geodesic fields that nobody uses any more: 6 MB each at 1 mm


@dataclass(frozen=True, eq=False)
class Target:
    """A place to reach: on the centreline of a branch, or any point in the lumen.

    Attributes:
        name: the target's name: that of its branch, or for the target at its open end that and "_end"; that of a point
            is made of its coordinates.
        branch: the branch it lies in.
        position: (3,) m, world frame.
        arc: m along the branch, from where that begins on its parent's centreline.
        aside: m from the centreline.
    """

    name: str
    branch: str
    position: NDArray[np.float64]
    arc: float
    aside: float = 0.0

    @property
    def at_end(self) -> bool:
        """Whether it is the target at its branch's open end."""
        return self.name == self.branch + END_SUFFIX


def _named_fields() -> KeptWhileUsed[LatticeField]:
    return KeptWhileUsed(_NAMED_KEPT)


def _point_fields() -> KeptWhileUsed[LatticeField]:
    return KeptWhileUsed(_POINTS_KEPT)


@dataclass(frozen=True, eq=False)
class Phantom:
    """One anatomy, ready for simulation."""

    name: str  # its name in the library
    hash: str  # hexadecimal digest of everything that determines its geometry
    parameters: Recipe | None  # what the arch was generated from, None for a mesh's
    tree: VesselTree  # branches with centreline and radius
    grid: SignedDistanceGrid  # signed distance to the wall, positive inside
    # places to reach, by name; those at the open ends of branches are added where they are missing
    targets: dict[str, Target]
    entries: dict[str, Entry]  # the aorta's ends, by name; `entry` knows more places to come in
    imported: ImportReport | None = None  # the account of the import, for a phantom from a mesh
    # what it was imported with, of a phantom from files: the arguments of `import_anatomy`
    source: Mapping[str, Any] | None = field(default=None, repr=False)
    _load_field: Callable[[str], LatticeField | None] | None = field(default=None, repr=False)
    _save_field: Callable[[str, LatticeField], None] | None = field(default=None, repr=False)
    _fields: dict[str, LatticeField] = field(default_factory=dict, repr=False)  # computed
    # of each phantom alone, also of one made by `dataclasses.replace`
    _read: KeptWhileUsed[LatticeField] = field(init=False, default_factory=_named_fields, repr=False)
    _points: KeptWhileUsed[LatticeField] = field(init=False, default_factory=_point_fields, repr=False)
    _lock: threading.Lock = field(init=False, default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        ends = {
            name: target
            for name, target in locate_end_targets(self.tree).items()
            if name not in self.targets and self.grid.sample(target.position) > 0
        }
        object.__setattr__(self, "targets", {**self.targets, **ends})

    def __repr__(self) -> str:
        return f"Phantom({self.name!r}, {self.hash}, grid {self.grid.shape} at {self.grid.spacing:g} m)"

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_read", "_points", "_lock")}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state, _read=_named_fields(), _points=_point_fields(), _lock=threading.Lock())

    def __deepcopy__(self, memo: dict[int, object]) -> Phantom:
        return self  # never changes, so that copied environments go on sharing its grids

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner (2, 3) m of the lumen, world frame."""
        return self._bounds.copy()

    @cached_property
    def _bounds(self) -> NDArray[np.float64]:
        return self.grid.coordinates(self.grid.inside_box())

    @cached_property
    def depths(self) -> BranchDepths:
        """Branches in which points are, and their depths behind the ostia."""
        return BranchDepths(self.tree)

    def target(self, target: TargetLike) -> Target:
        """The target of a name, or of a point (3,) m in the lumen, world frame.

        "point_1", "point_2" and so on are points on the centrelines of the aorta's branches, drawn by the phantom's
        name and their number; "rcca@80" lies on the centreline of `rcca`, 80 mm behind its ostium.

        Raises:
            ValueError: for an unknown name, listing the valid ones; for a point outside the lumen, or beyond a branch's
                end.
        """
        place = as_target(target)
        if not isinstance(place, str):
            require_inside(place, self.grid, self.name)
            return self._point_target(target_name(place), place)
        if place not in self.targets:
            drawn = drawn_point(place, self.name, self.tree, self.grid)
            if drawn is not None:
                return self._point_target(place, drawn)
            if (along := depth_in_branch(place)) and along[0] in self.tree.names:
                return self._target_along(place, *along)
            known = ", ".join(self.targets)
            raise ValueError(f"unknown target {place!r} in phantom {self.name!r}; choose from {known}.")
        return self.targets[place]

    def _target_along(self, name: str, branch: str, depth: float) -> Target:
        start, length = self.tree.ostium_arc(branch), self.tree[branch].length
        if start + depth > length:
            deepest = math.floor(1e3 * (length - start))
            raise ValueError(
                f"target {name} lies beyond the end of {branch} in phantom {self.name!r}: it goes on for {deepest} mm "
                f"behind its ostium, so choose {branch}@{deepest} or nearer"
            )
        return Target(name, branch, self.tree[branch].point_at(start + depth), start + depth)

    def _point_target(self, name: str, place: Point) -> Target:
        branch, arc, aside = nearest_branch(place, self.tree)
        return Target(name, branch, np.array(place), arc, aside)

    def entry(self, entry: EntryLike = "descending") -> Entry:
        """The entry of a name, or at a point in the lumen.

        Args:
            entry: one of `entries`; the open end of a branch, such as "lsa_end"; a point (3,) m where the sheath ends,
                or its text of `entry_name`. The sheath of a point lies along the centreline, towards the heart, or
                towards the target that the text names.

        Raises:
            ValueError: an unknown name, listing the valid ones; a point outside the lumen, or beside a wall that the
                sheath would point at.
        """
        name = entry_name(entry)
        if name in self.entries:
            return self.entries[name]
        ends = end_names(self.tree)
        if name in ends:
            return end_entry(name, self.tree)
        place = read_point(name)
        if place is None:
            known = ", ".join((*self.entries, *ends))
            raise ValueError(
                f"unknown entry {name!r} in phantom {self.name!r}; choose from {known}, or give a point in m."
            )
        goal = None if place[1] is None else self.target(place[1])
        along = None if goal is None else (goal.branch, goal.arc)
        return point_entry(name, place[0], self.tree, self.grid, self.name, along)

    def geodesic_field(self, target: TargetLike) -> LatticeField:
        """In-lumen distance to a target on the grid's lattice; read from the cache or computed when it is wanted.

        Args:
            target: one of `targets`, or a point in the lumen, (3,) m: computed in about a second at 1 mm, kept while it
                is used, and then only with the last few points.

        Returns:
            Distances in m, finite everywhere.
        """
        name = as_target(target)
        with self._lock:
            if not isinstance(name, str) or name not in self.targets:
                return self._points.take(name, lambda: geodesic_field(self.grid, self.target(name).position))
            if name in self._fields:
                return self._fields[name]
            return self._read.take(name, lambda: self._read_or_computed(name))

    def _read_or_computed(self, name: str) -> LatticeField:
        place = self.target(name)
        loaded = self._load_field(name) if self._load_field is not None else None
        if loaded is not None:
            return loaded
        self._fields[name] = geodesic_field(self.grid, place.position)  # which takes long: it is kept
        if self._save_field is not None:
            self._save_field(name, self._fields[name])
        return self._fields[name]

    def geodesic_distance(self, points: ArrayLike, target: TargetLike) -> NDArray[np.float64]:
        """In-lumen distance (...,) m from points (..., 3) m to a target, trilinear in the geodesic field.

        A little outside the lumen the nearest inside value counts.
        """
        return self.geodesic_field(target).sample(points)

    def way_length(self, target: TargetLike, entry: EntryLike = "descending") -> float:
        """Arc length (m) from an entry to a target along the centrelines, and from there to the target itself."""
        place, start = self.target(target), self.entry(entry).position
        nearest = [int(np.argmin(((branch.points - start) ** 2).sum(axis=1))) for branch in self.tree]
        gaps = [float(np.linalg.norm(b.points[i] - start)) for b, i in zip(self.tree, nearest, strict=True)]
        first = int(np.argmin(gaps))
        branch = self.tree.branches[first]
        along = graph_distance(self.tree, branch.name, branch.arc[nearest[first]], place.branch, place.arc)
        return float(along) + place.aside

    @cached_property
    def lumen_mesh(self) -> trimesh.Trimesh:
        """Watertight surface of the lumen, m, world frame, normals pointing out of the lumen."""
        from cathsim.anatomy.surface import lumen_surface

        return lumen_surface(self.grid)

    def wall_mesh(self, thickness: float = 1.5e-3) -> trimesh.Trimesh:
        """The vessel wall of a thickness (m) as a solid, cut open at the ends, m, world frame."""
        from cathsim.anatomy.surface import wall_surface

        return wall_surface(self.grid, self.tree, thickness)

    def dimensions(self) -> dict[str, float | int]:
        """Lumen volume (mL), length of the aorta (mm), number of branches, median diameters (mm) of the main ones."""
        branches = {branch.name: branch for branch in self.tree.branches}
        row: dict[str, float | int] = {
            "lumen_volume_ml": round(float(self.lumen_mesh.volume) * 1e6, 1),
            "aorta_length_mm": round(branches["aorta"].length * 1e3, 1),
            "branches": len(branches),
        }
        for name in ("aorta", "bca", "lcca", "lsa"):
            if name in branches:
                row[f"{name}_diameter_mm"] = round(2 * float(np.median(branches[name].radius)) * 1e3, 1)
        return row


def locate_targets(tree: VesselTree, share: float = 1.0) -> dict[str, Target]:
    """Targets of an aortic arch on the centrelines, at TARGET_DISTANCE; none where a branch is missing or too short.

    Args:
        share: of TARGET_DISTANCE, for small arches.
    """
    targets = {}
    for name, distance in TARGET_DISTANCE.items():
        if name in tree:
            arc = tree.ostium_arc(name) + share * distance
            clearance = END_CLEARANCE if tree[name].open_end else 0.0
            if arc + clearance <= tree[name].length:
                targets[name] = Target(name, name, tree[name].point_at(arc), arc)
    return targets


def target_share(tree: VesselTree) -> float:
    """Share of TARGET_DISTANCE at which every target of the arch fits into its branch; at most 1."""
    free = [
        (tree[name].length - tree.ostium_arc(name) - (END_CLEARANCE if tree[name].open_end else 0.0)) / distance
        for name, distance in TARGET_DISTANCE.items()
        if name in tree
    ]
    return float(min(1.0, 0.999 * min(free, default=1.0)))


def locate_end_targets(tree: VesselTree) -> dict[str, Target]:
    """Targets by name, e.g. "lcca_end", END_DISTANCE before the open ends of branches that are long enough.

    The root's own ends are access sites, and no targets.
    """
    targets = {}
    for branch in tree.branches[1:]:
        arc = branch.length - END_DISTANCE
        # the exact ostium would cost every load a search; its parent's radius bounds it well enough
        leaves = tree[branch.parent].radius_at(branch.parent_arc) if branch.parent else 0.0
        if branch.open_end and arc > leaves:
            name = branch.name + END_SUFFIX
            targets[name] = Target(name, branch.name, branch.point_at(arc), arc)
    return targets
