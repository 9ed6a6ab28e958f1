"""A phantom from the triangles of a lumen's surface: its lumen, ends, vessels, names, distance grid and report."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import LumenPaths, Voxels
from cathsim.anatomy.mesh.arches.arch_naming import LabelOf, labelled_names, labelled_sides, name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel, build_vessels, turned
from cathsim.anatomy.mesh.budget import Budget
from cathsim.anatomy.mesh.cavity import Cavity, find_cavity, largest_part
from cathsim.anatomy.mesh.distance import distance_grid, lumen_samples, trim_cavity, voxels_away
from cathsim.anatomy.mesh.ends import VesselEnd, end_at_opening, find_end, same_end, severs
from cathsim.anatomy.mesh.lattice import lattice_spacing
from cathsim.anatomy.mesh.naming import (
    ascending_score,
    ordered_names,
    propose_entries,
    propose_targets,
    renamed,
    world_rotation,
)
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Size, Triangles, clean_triangles, measure_size
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError, draw_refusal
from cathsim.anatomy.mesh.samples import SurfaceSamples, sample_surface
from cathsim.anatomy.mesh.tree import TreeSettings, grow_tree
from cathsim.anatomy.phantom import Phantom

logger = logging.getLogger(__name__)

LEAST_WIDTH = 1e-3  # m: a lumen of a smaller radius is too narrow for a wire to be steered in
_PASSABLE = 6e-4  # m: the aorta of a smaller radius lets no wire pass
_CHILD = 16e-3  # m of width, of the widest place: narrower aortas get a grid of half the distance
_FINEST_GRID = 5e-4  # m
_TORN_OFF = 0.03  # of the lumen: a part of this size that no coarse voxel joins to the rest is no speck
_AT_OPENING = 3.0  # coarse voxels between the middle of an opening and the lumen's nearest one
_SHORT_OF = 4e-3  # m before an opening at which an end that was found otherwise may lie
_BESIDE = 1.6  # radii from the middle of an end: a way that leads further off leads elsewhere
_NARROWER = 0.7  # of a wide vessel's radius: the end of a short one beside it is not wider
_SAMPLES = 0.7  # voxels between points on the surface

Names = Mapping[str, str] | Sequence[str] | None
Array = NDArray[np.float64]


@dataclass(frozen=True)
class SurfaceFacts:
    """What is known of a surface's source, for the account of the import."""

    file: str  # name of the file or folder
    unit: str = "m"  # the file's unit
    unit_reason: str = "given"
    faces: int = 0  # triangles in the file
    scale: float = 1.0  # m per unit of the file
    notes: tuple[str, ...] = ()  # what was done before
    width: float = 0.0  # m, of the widest ball in the lumen; measured where it is left out


def phantom_of_surface(
    mesh: Triangles,
    facts: SurfaceFacts,
    *,
    name: str,
    digest: str,
    resolution: float = 1e-3,
    frame: Array | None = None,
    label_of: LabelOf | None = None,
    names: Names = None,
    picture: Path | None = None,
) -> Phantom:
    """Makes a phantom of the surface of a lumen, or of a thick-walled model of one.

    Args:
        mesh: triangles, m, in any order and orientation; borders are closed.
        facts: of the source, for the report.
        name, digest: of the phantom.
        resolution: m between lattice points of the distance grid; half of it for a child's vessels.
        frame: (3, 3) rows are the patient's left, posterior and superior axis in the surface's frame; estimated from
            the vessels where it is left out.
        label_of: names ("" where there is none) of the vessels at points (n, 3) m of the surface's frame; where it is
            left out vessels are named by their order along the arch.
        names: names of the user's own: a mapping from automatic names, or a list for the aorta's branches from the
            heart on.
        picture: PNG file to draw where the surface is refused.

    Raises:
        MeshRefusedError: with the reason.
    """
    build = SurfaceImport(facts, name, digest, resolution, frame, label_of, names)
    try:
        return build.phantom(mesh)
    except MeshRefusedError as error:
        drawn = None if picture is None else build.picture(error.reason, picture)
        raise MeshRefusedError(error.reason, drawn) from None


@dataclass(eq=False)
class SurfaceImport:
    """One import; keeps what it found so far, for a picture of a refusal."""

    facts: SurfaceFacts
    name: str
    digest: str
    resolution: float
    frame: Array | None = None
    label_of: LabelOf | None = None
    names: Names = None
    budget: Budget = field(default_factory=Budget)
    samples: SurfaceSamples | None = None
    cavity: Cavity | None = None
    surface: Array | None = None

    def phantom(self, mesh: Triangles) -> Phantom:
        """Builds the phantom."""
        notes = self.facts.notes
        mesh, more = clean_triangles(mesh)
        notes += more
        self.surface = mesh.corners.mean(axis=1)
        if len(mesh.faces) < 4:
            raise MeshRefusedError(f"{self.facts.file} holds no surface; its faces have no area.")
        mesh, openings, put_back = close_openings(mesh)
        if put_back:
            notes += (f"{put_back} missing triangles put back",)
        sides = np.ptp(mesh.bounds, axis=0)
        width = self.facts.width or measure_size(mesh, self.budget).width
        if width < _CHILD and self.resolution / 2 >= _FINEST_GRID:
            self.resolution /= 2
            notes += (f"distances every {1e3 * self.resolution:g} mm: its vessels are a child's",)
        spacing = lattice_spacing(width, sides, self.resolution, self.budget, self.facts.unit)
        self.samples = sample_surface(mesh.corners, _SAMPLES * spacing, self.budget)
        self.budget.check_time("finding the lumen")
        self.cavity = cavity = find_cavity(self.samples, spacing)
        scale = self.facts.scale
        given = self.facts.unit_reason == "given"
        if given and (hint := Size(2 * cavity.widest / scale, mesh.extent / scale).hint(self.facts.unit)):
            notes += (hint,)
        self.budget.check_time("finding its ends")
        ends, lost = _find_ends(cavity, openings)
        notes += lost
        inside = trim_cavity(cavity, ends)
        away = voxels_away(inside)
        surface = lumen_samples(self.samples, cavity, inside, ends, away)
        self.budget.check_time("finding its vessels")
        aorta, ends = _find_vessels(cavity, inside, ends)

        if self.frame is None:
            leftward = None if self.label_of is None else labelled_sides(aorta, self.label_of)
            rotation, kept = world_rotation(aorta, leftward)
        else:
            rotation = np.asarray(self.frame, dtype=np.float64)
            kept = bool(np.isclose(np.abs(rotation).max(axis=1), 1.0).all())
        lumen = (cavity.origin + np.argwhere(inside) * spacing) @ rotation.T
        offset = -(lumen.min(axis=0) + lumen.max(axis=0)) / 2
        if not kept and self.frame is None:
            notes += ("the file's axes are not the patient's: the pose is estimated from the vessels",)
        aorta = turned(aorta, rotation, offset)
        if self.label_of is None:
            automatic, named = name_vessels(aorta, sides_known=self.frame is not None)
        else:
            label_of = self.label_of
            automatic, named = labelled_names(aorta, lambda points: label_of((points - offset) @ rotation))
        own = self.names if self.names is None or isinstance(self.names, Mapping) else None
        if self.names is not None and own is None:
            own = ordered_names(aorta, automatic, list(self.names))
        final = renamed(automatic, own)
        while True:
            self.budget.check_time("measuring distances to its wall")
            grid = distance_grid(
                surface, cavity, inside, ends, away, rotation=rotation, offset=offset, resolution=self.resolution
            )
            self.budget.check_time("drawing its centrelines")
            least = max(LEAST_WIDTH, 1.25 * self.resolution)
            tree, left_out = grow_tree(aorta, final, grid, TreeSettings(least))
            thinnest = int(np.argmin(tree.root.radius))
            narrowest = float(tree.root.radius[thinnest])
            if narrowest >= least or self.resolution / 2 < _FINEST_GRID:
                break
            self.resolution /= 2
            notes += (f"distances every {1e3 * self.resolution:g} mm: the aorta is narrow",)
        if narrowest < least and grid.sample(tree.root.points[thinnest]) <= 0:
            place = (tree.root.points[thinnest] - offset) @ rotation / scale
            raise MeshRefusedError(
                f"the aorta cannot be followed at ({', '.join(f'{x:.4g}' for x in place)}) of the file: its surface is "
                "torn, doubled or badly closed there; repair it, or cut the mesh to the arch and its branches."
            )
        if narrowest < _PASSABLE:
            raise MeshRefusedError(
                f"the aorta narrows to {narrowest * 1e3:.2f} mm of radius, too narrow for a wire "
                f"({_PASSABLE * 1e3:.1f} mm); check the unit, here {self.facts.unit}."
            )
        if narrowest < least:
            notes += (f"the aorta narrows to {narrowest * 1e3:.1f} mm of radius",)
        targets, shortened = propose_targets(tree)
        if not targets:
            raise MeshRefusedError("no branch of this vessel is wide and long enough for a wire and a target.")
        entries = propose_entries(tree)
        phantom = Phantom(self.name, self.digest, None, tree, grid, targets, entries)  # knows the way to each target
        report = ImportReport(
            file=self.facts.file,
            unit=self.facts.unit,
            unit_reason=self.facts.unit_reason,
            faces=self.facts.faces,
            kind=cavity.kind,
            borders=len(openings),
            rotation=tuple(tuple(float(x) for x in row) for row in rotation),  # type: ignore[misc]
            offset=tuple(float(x) for x in offset),  # type: ignore[arg-type]
            scale=scale,
            axes_kept=kept,
            automatic_names={automatic[key]: name for key, name in final.items() if name in tree},
            way_length={name: round(phantom.way_length(name), 4) for name in phantom.targets},
            notes=notes + named + left_out + shortened,
        )
        for note in report.notes:
            logger.info("%s: %s.", self.facts.file, note)
        return replace(phantom, imported=report)

    def picture(self, reason: str, path: Path) -> Path | None:
        """Draws what came."""
        if self.surface is None or len(self.surface) == 0:
            return None
        found = np.zeros((0, 3))
        surface = self.surface if self.samples is None else self.samples.points
        if self.cavity is not None:
            found = self.cavity.origin + np.argwhere(self.cavity.inside) * self.cavity.spacing
        return draw_refusal(surface, found, f"{self.facts.file}: {reason}", path)


def _find_ends(cavity: Cavity, openings: Array) -> tuple[list[VesselEnd], tuple[str, ...]]:
    """The ends of all vessels, and notes on those that were given up.

    A lumen of fewer than three ends has no branch to steer into.
    """
    from scipy.ndimage import binary_dilation, label

    paths = _coarse(cavity, cavity.inside)
    labels, _ = label(paths.inside, np.ones((3, 3, 3)))
    parts = np.sort(np.bincount(labels[paths.inside]))[::-1]
    if parts[1] > _TORN_OFF * parts.sum():
        raise MeshRefusedError(
            f"the lumen narrows to less than {1e3 * paths.spacing:.1f} mm of width between two parts of it, too narrow "
            "for a wire at this resolution; take a finer one, or check the unit."
        )
    voxels = paths.ends(_voxels_at(paths, openings))
    if len(voxels) < 2:
        raise MeshRefusedError("the lumen is no vessel: it has no two ends; expected an aorta with its branches.")
    ways = paths.ways(voxels[0], voxels[1:])
    longest = max(ways, key=len)
    wall = binary_dilation(cavity.wall)
    found: list[tuple[VesselEnd, Voxels]] = []
    lost = 0
    for way in [longest[::-1], *ways]:
        points, depth = paths.points(way), paths.depth[tuple(way.T)]
        end = find_end(cavity, wall, points, depth)
        if end is not None and (others := [o for o, _ in found if same_end(end, o) and _is_beside(o, points[-1])]):
            # A short vessel beside a wide one: what was found is that one's end.
            end = end_at_opening(cavity, points, depth, openings, flared=True)
            end = end or find_end(cavity, wall, points, depth, others)
            if end is not None and end.radius > _NARROWER * others[0].radius:
                end = None
        else:
            open_end = end_at_opening(cavity, points, depth, openings)
            if open_end is not None and (end is None or (end.centre - open_end.centre) @ open_end.normal < -_SHORT_OF):
                end = open_end
        if end is None:
            lost += 1
        elif not any(same_end(end, other) for other, _ in found):
            found.append((end, way))
    ends = [
        end
        for end, own in found
        if not any(severs(end, paths.points(way)) for way in ways if _leads_elsewhere(way, own))
    ]
    lost += len(found) - len(ends)
    if lost > len(voxels) // 2:
        raise MeshRefusedError(
            f"no wall surrounds the vessel at {lost} of the lumen's {len(voxels)} ends: loose sheets or spikes stand "
            "in it, or its wall is torn; repair the mesh, or cut it to the arch and its branches."
        )
    if len(ends) < 3:
        raise MeshRefusedError(
            f"the lumen has {len(ends)} ends, an aorta with a branch has at least three; "
            "a vessel without a side branch offers no target."
        )
    return ends, (f"{lost} of {len(voxels)} ends of vessels left out: the wall does not surround them",) if lost else ()


def _leads_elsewhere(way: Voxels, own: Voxels) -> bool:
    """Whether a way has other ends than the one that an end was found along."""
    return not (np.array_equal(way[0], own[0]) and np.array_equal(way[-1], own[-1]))


def _voxels_at(paths: LumenPaths, places: Array) -> Voxels:
    """The lumen's voxels (k, 3) next to those of some places (n, 3) m that lie at the lumen, the widest first."""
    lumen = np.argwhere(paths.inside)
    if len(places) == 0:
        return lumen[:0]
    from scipy.spatial import cKDTree

    away, nearest = cKDTree(paths.points(lumen)).query(places)
    at = lumen[nearest[away < _AT_OPENING * paths.spacing]]
    return at[np.argsort(-paths.depth[tuple(at.T)], kind="stable")]


def _is_beside(end: VesselEnd, tip: Array) -> bool:
    """Whether a way's last point lies beside the vessel that an end closes."""
    return bool(np.linalg.norm(tip - end.centre) > _BESIDE * end.radius)


def _find_vessels(
    cavity: Cavity, inside: NDArray[np.bool_], ends: list[VesselEnd]
) -> tuple[RoughVessel, list[VesselEnd]]:
    """Vessels between the ends, from the descending end of the aorta on."""
    paths = _coarse(cavity, inside)
    lumen = np.argwhere(largest_part(paths.inside, np.ones((3, 3, 3))))  # no way leads to the other parts
    at = paths.points(lumen)
    places = []
    for end in ends:
        behind = end.centre - min(0.5 * end.radius, 3e-3) * end.normal
        away = ((at - behind) ** 2).sum(axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] > (end.radius + 4 * cavity.spacing) ** 2:
            raise MeshRefusedError(
                "the lumen falls apart where its ends are cut: its surface is torn, doubled or crosses itself; repair "
                "it, or cut the mesh to the arch and its branches."
            )
        places.append(lumen[nearest])
    by_radius = sorted(range(len(ends)), key=lambda n: -ends[n].radius)

    def vessels(first: int, last: int) -> RoughVessel:
        others = [n for n in range(len(ends)) if n != first]
        ways = paths.ways(places[first], np.array([places[n] for n in others]))
        points = [
            np.concatenate([ends[first].centre[None], paths.points(way)[1:-1], ends[n].centre[None]])
            for n, way in zip(others, ways, strict=True)
        ]
        depths = [paths.depth[tuple(way.T)] for way in ways]
        return build_vessels(ways, points, depths, others.index(last))

    first, last = by_radius[1], by_radius[0]
    aorta = vessels(first, last)
    if ascending_score(aorta, ends[first].radius, ends[last].radius) < 0:
        aorta = vessels(last, first)
    if not aorta.children:
        raise MeshRefusedError("the aorta has no branch to steer into; expected an aortic arch with its branches.")
    return aorta, ends


def _coarse(cavity: Cavity, inside: NDArray[np.bool_]) -> LumenPaths:
    """Every second voxel: fine enough for ways, and eight times as fast."""
    return LumenPaths(np.ascontiguousarray(inside[::2, ::2, ::2]), cavity.origin, 2 * cavity.spacing)
