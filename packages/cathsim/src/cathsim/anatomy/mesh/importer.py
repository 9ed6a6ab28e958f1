"""A phantom from a user's mesh: any surface of an aortic arch's lumen or wall, in any unit and pose."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import LumenPaths, Voxels
from cathsim.anatomy.mesh.branches import RoughVessel, build_vessels, turned
from cathsim.anatomy.mesh.budget import Budget
from cathsim.anatomy.mesh.cavity import Cavity, find_cavity, largest_part
from cathsim.anatomy.mesh.distance import distance_grid, lumen_samples, trim_cavity
from cathsim.anatomy.mesh.ends import VesselEnd, find_end, severs
from cathsim.anatomy.mesh.naming import (
    ascending_score,
    name_vessels,
    ordered_names,
    propose_entries,
    propose_targets,
    renamed,
    world_rotation,
)
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import (
    UNITS,
    Size,
    check_unit,
    clean_triangles,
    detect_unit,
    measure_size,
    read_triangles,
)
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError, draw_refusal
from cathsim.anatomy.mesh.samples import SurfaceSamples, sample_surface
from cathsim.anatomy.mesh.tree import TreeSettings, grow_tree
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.phantom_cache import PhantomCache, default_cache_directory

logger = logging.getLogger(__name__)

IMPORT_VERSION = 3  # raise it whenever the same file gives another phantom
FINEST, COARSEST = 5e-4, 2.5e-3  # m, resolutions
LEAST_WIDTH = 1e-3  # m: a lumen of a smaller radius is too narrow for a wire to be steered in
_TORN_OFF = 0.03  # of the lumen: a part of this size that no coarse voxel joins to the rest is no speck
_AT_OPENING = 3.0  # coarse voxels between the middle of an opening and the lumen's nearest one
_SAMPLES = 0.7  # voxels between points on the surface

_importing = threading.Lock()
Names = Mapping[str, str] | Sequence[str] | None
Array = NDArray[np.float64]


def import_mesh(
    path: str | Path,
    *,
    unit: str | None = None,
    names: Names = None,
    resolution: float = 1e-3,
    cache_dir: Path | None = None,
) -> Phantom:
    """Makes a phantom of the surface of a lumen, or of a thick-walled model of one; cached by content.

    Args:
        path: an STL, OBJ or PLY file.
        unit: "m", "cm", "mm" or "inch"; detected from the vessels' width where it is left out.
        names: names of your own: a mapping from automatic names, or a list for the aorta's branches from the heart on.
        resolution: m between lattice points of the distance grid.
        cache_dir: where built phantoms are kept; by default $CATHSIM_CACHE, else the user's cache directory.

    Returns:
        The phantom, in the patient's frame as far as the vessels show it; `phantom.imported` is the account of the
        import.

    Raises:
        MeshRefusedError: a ValueError with the reason, and where there is something to see a picture.
        ValueError: for an impossible resolution.
    """
    check_unit(unit)
    if not (isinstance(resolution, int | float) and math.isfinite(resolution) and FINEST <= resolution <= COARSEST):
        raise ValueError(f"resolution must lie in [{FINEST:g}, {COARSEST:g}] m for a mesh, got {resolution!r}.")
    path = Path(path).expanduser()
    directory = default_cache_directory() if cache_dir is None else Path(cache_dir)
    chosen: tuple | None = None if not names else tuple(names.items()) if isinstance(names, Mapping) else tuple(names)
    with _importing:
        return _load(
            path, mesh_digest(path, unit, chosen, float(resolution)), unit, chosen, float(resolution), directory
        )


def mesh_digest(path: Path, unit: str | None, names: tuple | None, resolution: float) -> str:
    """The hash of the phantom that an import gives: of the file's content and the settings."""
    digest = hashlib.blake2b(digest_size=16)
    settings = {"importer": IMPORT_VERSION, "unit": unit, "names": names, "resolution": resolution}
    digest.update(json.dumps(settings).encode())
    if not path.is_file():
        raise MeshRefusedError(f"there is no file {path}; give the path of an STL, OBJ or PLY file.")
    with path.open("rb") as file:
        while block := file.read(1 << 22):
            digest.update(block)
    return digest.hexdigest()


@lru_cache(maxsize=16)
def _load(
    path: Path, digest: str, unit: str | None, names: tuple | None, resolution: float, directory: Path
) -> Phantom:
    cache = PhantomCache(directory)
    phantom = cache.read(path.stem, digest, None)
    if phantom is None:
        own: Names = dict(names) if names and isinstance(names[0], tuple) else names
        build = _Import(path, unit, own, resolution)
        try:
            phantom = build.phantom(digest)
        except MeshRefusedError as error:
            reason = error.reason if unit is None else build.with_unit_hint(error.reason)
            picture = build.picture(reason, directory / "refused" / f"{path.stem}-{digest[:12]}.png")
            raise MeshRefusedError(reason, picture) from None
        cache.write(phantom)
    return replace(phantom, source={"path": str(path.resolve()), "unit": unit, "names": names})


@dataclass(eq=False)
class _Import:
    """One import; keeps what it found so far, for a picture of a refusal."""

    path: Path
    unit: str | None
    names: Names
    resolution: float
    budget: Budget = field(default_factory=Budget)
    samples: SurfaceSamples | None = None
    cavity: Cavity | None = None
    surface: Array | None = None

    def phantom(self, digest: str) -> Phantom:
        """Builds the phantom."""
        mesh = read_triangles(self.path)
        faces = len(mesh.faces)
        mesh, notes = clean_triangles(mesh)
        self.surface = mesh.corners.mean(axis=1)
        if len(mesh.faces) < 4:
            raise MeshRefusedError(f"{self.path.name} holds no surface; its faces have no area.")
        mesh, openings, put_back = close_openings(mesh)
        if put_back:
            notes += (f"{put_back} missing triangles put back",)
        self.budget.check_time("measuring its size")
        reason = "given"
        if self.unit is None:
            self.unit, reason, unsure = detect_unit(measure_size(mesh, self.budget))
            notes += unsure
        scale = UNITS[self.unit]
        extent = mesh.extent
        mesh = mesh.scaled(scale)
        self.surface = self.surface * scale
        spacing = self.resolution / 2
        sides = np.ptp(mesh.bounds, axis=0)
        size = " x ".join(f"{1e3 * side:.4g}" for side in sides)
        self.budget.check_lattice(float(np.prod(sides / spacing)), spacing, f"{size} mm in {self.unit}")
        self.samples = sample_surface(mesh.corners, _SAMPLES * spacing, self.budget)
        self.budget.check_time("finding the lumen")
        self.cavity = cavity = find_cavity(self.samples, spacing)
        if reason == "given" and (hint := Size(2 * cavity.widest / scale, extent).hint(self.unit)):
            notes += (hint,)
        self.budget.check_time("finding its ends")
        ends, lost = _find_ends(cavity, openings * scale)
        notes += lost
        inside = trim_cavity(cavity, ends)
        surface = lumen_samples(self.samples, cavity, inside, ends)
        self.budget.check_time("finding its vessels")
        aorta, ends = _find_vessels(cavity, inside, ends)

        rotation, kept = world_rotation(aorta)
        lumen = (cavity.origin + np.argwhere(inside) * spacing) @ rotation.T
        offset = -(lumen.min(axis=0) + lumen.max(axis=0)) / 2
        if not kept:
            notes += ("the file's axes are not the patient's: the pose is estimated from the vessels",)
        self.budget.check_time("measuring distances to its wall")
        grid = distance_grid(
            surface, cavity, inside, ends, rotation=rotation, offset=offset, resolution=self.resolution
        )
        self.budget.check_time("drawing its centrelines")
        aorta = turned(aorta, rotation, offset)
        automatic, more = name_vessels(aorta)
        own = self.names if self.names is None or isinstance(self.names, Mapping) else None
        if self.names is not None and own is None:
            own = ordered_names(aorta, automatic, list(self.names))
        final = renamed(automatic, own)
        least = max(LEAST_WIDTH, 1.25 * self.resolution)
        tree, left_out = grow_tree(aorta, final, grid, TreeSettings(least))
        thinnest = int(np.argmin(tree.root.radius))
        narrowest = float(tree.root.radius[thinnest])
        if narrowest < least and grid.sample(tree.root.points[thinnest]) <= 0:
            place = (tree.root.points[thinnest] - offset) @ rotation / scale
            raise MeshRefusedError(
                f"the aorta cannot be followed at ({', '.join(f'{x:.4g}' for x in place)}) of the file: its surface is "
                "torn, doubled or badly closed there; repair it, or cut the mesh to the arch and its branches."
            )
        if narrowest < least:
            raise MeshRefusedError(
                f"the aorta narrows to {narrowest * 1e3:.2f} mm of radius, too narrow for a wire ({least * 1e3:.2f} mm "
                f"at this resolution); check the unit, here {self.unit}."
            )
        targets, shortened = propose_targets(tree)
        if not targets:
            raise MeshRefusedError("no branch of this vessel is wide and long enough for a wire and a target.")
        entries = propose_entries(tree)
        phantom = Phantom(self.path.stem, digest, None, tree, grid, targets, entries)  # knows the way to each target
        names_found = {automatic[key]: name for key, name in final.items() if name in tree}
        report = ImportReport(
            file=self.path.name,
            unit=self.unit,
            unit_reason=reason,
            faces=faces,
            kind=cavity.kind,
            borders=len(openings),
            rotation=tuple(tuple(float(x) for x in row) for row in rotation),  # type: ignore[misc]
            offset=tuple(float(x) for x in offset),  # type: ignore[arg-type]
            scale=scale,
            axes_kept=kept,
            automatic_names=names_found,
            way_length={name: round(phantom.way_length(name), 4) for name in phantom.targets},
            notes=notes + more + left_out + shortened,
        )
        for note in report.notes:
            logger.info("%s: %s.", self.path.name, note)
        return replace(phantom, imported=report)

    def with_unit_hint(self, reason: str) -> str:
        """A refusal under a given unit, with the unit that would fit where another does."""
        try:
            mesh, _ = clean_triangles(read_triangles(self.path))
            size = measure_size(close_openings(mesh)[0], Budget())
        except MeshRefusedError:  # there is nothing to measure: the reason says what there is to say
            return reason
        assert self.unit is not None
        hint = size.hint(self.unit)
        return f"{reason.rstrip('.')}; {hint}: give that unit, or leave it out." if hint else reason

    def picture(self, reason: str, path: Path) -> Path | None:
        """Draws what came."""
        if self.surface is None or len(self.surface) == 0:
            return None
        found = np.zeros((0, 3))
        surface = self.surface if self.samples is None else self.samples.points
        if self.cavity is not None:
            found = self.cavity.origin + np.argwhere(self.cavity.inside) * self.cavity.spacing
        return draw_refusal(surface, found, f"{self.path.name}: {reason}", path)


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
    found: list[VesselEnd] = []
    lost = 0
    for way in [longest[::-1], *ways]:
        end = find_end(cavity, wall, paths.points(way), paths.depth[tuple(way.T)])
        if end is None:
            lost += 1
        elif not any(_same(end, other) for other in found):
            found.append(end)
    ends = [end for end in found if not any(severs(end, paths.points(way)) for way in ways)]
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


def _voxels_at(paths: LumenPaths, places: Array) -> Voxels:
    """The lumen's voxels (k, 3) next to those of some places (n, 3) m that lie at the lumen, the widest first."""
    lumen = np.argwhere(paths.inside)
    if len(places) == 0:
        return lumen[:0]
    from scipy.spatial import cKDTree

    away, nearest = cKDTree(paths.points(lumen)).query(places)
    at = lumen[nearest[away < _AT_OPENING * paths.spacing]]
    return at[np.argsort(-paths.depth[tuple(at.T)], kind="stable")]


def _same(end: VesselEnd, other: VesselEnd) -> bool:
    gap = float(np.linalg.norm(end.centre - other.centre))
    return gap < 0.9 * max(end.radius, other.radius) and float(end.normal @ other.normal) > 0.3


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
