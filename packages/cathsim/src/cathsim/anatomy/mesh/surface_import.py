"""A phantom from the triangles of a lumen's surface: its lumen, ends, vessels, names, distance grid and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.mesh.arches.arch_naming import LabelOf, labelled_names, labelled_sides, name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel, turned
from cathsim.anatomy.mesh.cavity import Cavity, find_cavity
from cathsim.anatomy.mesh.completion import final_names, imported_phantom
from cathsim.anatomy.mesh.distance import distance_grid, lumen_samples, trim_cavity, voxels_away
from cathsim.anatomy.mesh.lattice import Budget, lattice_spacing
from cathsim.anatomy.mesh.lumen_vessels import count_rings, find_ends, find_vessels
from cathsim.anatomy.mesh.naming import pose_doubts, world_rotation
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Size, Triangles, clean_triangles, measure_size
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError, Names, draw_refusal
from cathsim.anatomy.mesh.samples import SurfaceSamples, sample_surface
from cathsim.anatomy.mesh.tree import grow_tree
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_names import SUPRA_AORTIC
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.anatomy.wall.thickness import fill_chambers, thicken_between_lumens

LEAST_WIDTH = 1e-3  # m: a lumen of a smaller radius is too narrow for a wire to be steered in
_PASSABLE = 6e-4  # m: the aorta of a smaller radius lets no wire pass
_MOST_WIDE_ENDS = 2  # beside the aorta's own: real ones have none or one, bones that are like an arch five and more
_CHILD = 16e-3  # m of width, of the widest place: narrower aortas get a grid of half the distance
_FINEST_GRID = 5e-4  # m
_SAMPLES = 0.7  # voxels between points on the surface

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
    nameless: bool = False  # whether it is a label volume's, of which nothing says that it is an aorta


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
    extend: bool = True,
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
        extend: whether branches that are cut short are extended.
        picture: PNG file to draw where the surface is refused.

    Raises:
        MeshRefusedError: with the reason.
    """
    build = SurfaceImport(facts, name, digest, resolution, frame, label_of, names, extend)
    try:
        return build.phantom(mesh)
    except MeshRefusedError as error:
        drawn = None if picture is None else build.picture(error.reason, picture)
        raise MeshRefusedError(error.reason, drawn) from None


def closed_lumen(mesh: Triangles, facts: SurfaceFacts, rotation: Array, resolution: float) -> SignedDistanceGrid:
    """The distance grid of a closed lumen, whose vessels are known otherwise, in a turned frame.

    Args:
        mesh: triangles, m.
        rotation: (3, 3) from the surface's frame to the grid's.
        resolution: m between lattice points.

    Raises:
        MeshRefusedError: with the reason.
    """
    build = SurfaceImport(facts, facts.file, "", resolution)
    samples, cavity = build._lumen(build._closed(mesh)[0])
    inside = trim_cavity(cavity, ())
    away = voxels_away(inside)
    surface = lumen_samples(samples, cavity, inside, (), away)
    offset, fine = np.zeros(3), build.resolution
    grid = distance_grid(surface, cavity, inside, (), away, rotation=rotation, offset=offset, resolution=fine)
    return fill_chambers(thicken_between_lumens(grid))


@dataclass(frozen=True)
class _Pose:
    """From the surface's frame to the phantom's: turned, then moved.

    Attributes:
        rotation: (3, 3).
        offset: (3,) m.
        axes_kept: whether each axis stays along an axis.
    """

    rotation: Array
    offset: Array
    axes_kept: bool

    def in_surface(self, points: Array) -> Array:
        """Points (..., 3) m of the phantom, in the surface's frame."""
        return (points - self.offset) @ self.rotation


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
    extend: bool = True
    budget: Budget = field(default_factory=Budget)
    samples: SurfaceSamples | None = None
    cavity: Cavity | None = None
    surface: Array | None = None
    notes: list[str] = field(default_factory=list)

    def phantom(self, mesh: Triangles) -> Phantom:
        """Builds the phantom."""
        self.notes = list(self.facts.notes)
        mesh, openings = self._closed(mesh)
        samples, cavity = self._lumen(mesh)
        self.budget.check_time("finding its ends")
        if rings := count_rings(cavity):
            form = "a ring" if rings == 1 else f"{rings} rings"
            self.notes.append(f"its vessels form {form}; those in a ring end where they meet, and nothing closes them")
        ends, lost = find_ends(cavity, openings, rings=rings > 0)
        self.notes += lost
        inside = trim_cavity(cavity, ends)
        away = voxels_away(inside)
        surface = lumen_samples(samples, cavity, inside, ends, away)
        self.budget.check_time("finding its vessels")
        scale, axes = self.facts.scale, self.frame
        aorta, unsure, unclear = find_vessels(cavity, inside, ends, rings=rings > 0, scale=scale, frame=axes)
        if self.facts.nameless and len(unsure) > _MOST_WIDE_ENDS:
            raise MeshRefusedError(
                f"{self.facts.file} seems to be no aorta: {len(unsure)} vessels beside its two ends are as wide; "
                "if it is one, say so by labels={number: 'aorta'}."
            )
        self.notes += unsure
        if unclear:
            self.notes.append("its shape hardly shows which of the aorta's two ends is the heart's: check the names")
        pose = self._pose(aorta, cavity.origin + np.argwhere(inside) * cavity.spacing)
        aorta = turned(aorta, pose.rotation, pose.offset)
        automatic, final, named = self._named(aorta, pose)
        grid_of = partial(
            distance_grid, surface, cavity, inside, ends, away, rotation=pose.rotation, offset=pose.offset
        )
        arch = self.label_of is not None or not set(SUPRA_AORTIC).isdisjoint(automatic.values())
        if self.facts.unit_reason.startswith("detected") and not arch:
            unit = f"{self.facts.unit} is the unit by an aorta's width, and no arch shows that this is one"
            named += (f"{unit}; give the unit of other vessels",)
        tree, grid, left_out = self._measured(aorta, final, grid_of, pose)
        if self.frame is not None:
            self.notes += pose_doubts(tree.root.points)
        report = ImportReport(
            file=self.facts.file,
            unit=self.facts.unit,
            unit_reason=self.facts.unit_reason,
            faces=self.facts.faces,
            kind=cavity.kind,
            borders=len(openings),
            rotation=pose.rotation,
            offset=pose.offset,
            scale=self.facts.scale,
            axes_kept=pose.axes_kept,
            automatic_names={automatic[key]: name for key, name in final.items()},
            way_length={},
            notes=(*self.notes, *named, *left_out),
        )
        return imported_phantom(tree, grid, report, name=self.name, digest=self.digest, extend=self.extend)

    def _closed(self, mesh: Triangles) -> tuple[Triangles, Array]:
        """The surface without what is no triangle and with its openings closed, and where these are."""
        mesh, notes = clean_triangles(mesh)
        self.notes += notes
        self.surface = mesh.corners.mean(axis=1)
        if len(mesh.faces) < 4:
            raise MeshRefusedError(f"{self.facts.file} holds no surface; its faces have no area.")
        mesh, openings, put_back = close_openings(mesh)
        if put_back:
            self.notes.append(f"{put_back} missing triangles put back")
        return mesh, openings

    def _lumen(self, mesh: Triangles) -> tuple[SurfaceSamples, Cavity]:
        """Points on the surface, and the lumen that it encloses."""
        width = self.facts.width or measure_size(mesh, self.budget).width
        if width < _CHILD and self.resolution / 2 >= _FINEST_GRID:
            self.resolution /= 2
            self.notes.append(f"distances every {1e3 * self.resolution:g} mm: its vessels are a child's")
        sides = np.ptp(mesh.bounds, axis=0)
        spacing, coarser = lattice_spacing(width, sides, self.resolution, self.budget, self.facts.unit)
        self.notes += coarser
        self.samples = sample_surface(mesh.corners, _SAMPLES * spacing, self.budget)
        self.budget.check_time("finding the lumen")
        self.cavity = cavity = find_cavity(self.samples, spacing)
        if self.facts.unit_reason == "given":
            size = Size(2 * cavity.widest / self.facts.scale, mesh.extent / self.facts.scale)
            if hint := size.hint(self.facts.unit):
                self.notes.append(hint)
        return self.samples, cavity

    def _pose(self, aorta: RoughVessel, lumen: Array) -> _Pose:
        """How the lumen (n, 3) m is turned into the patient's axes and centred."""
        if self.frame is None:
            leftward = None if self.label_of is None else labelled_sides(aorta, self.label_of)
            rotation, axis_aligned = world_rotation(aorta, leftward)
            if not axis_aligned:
                self.notes.append("the file's axes are not the patient's: the pose is estimated from the vessels")
        else:
            rotation = np.asarray(self.frame, dtype=np.float64)
            axis_aligned = bool(np.isclose(np.abs(rotation).max(axis=1), 1.0).all())
        lumen = lumen @ rotation.T
        return _Pose(rotation, -(lumen.min(axis=0) + lumen.max(axis=0)) / 2, axis_aligned)

    def _named(self, aorta: RoughVessel, pose: _Pose) -> tuple[dict[int, str], dict[int, str], tuple[str, ...]]:
        """Automatic and final names of the vessels, and notes on them."""
        if self.label_of is None:
            automatic, notes = name_vessels(aorta, sides_known=self.frame is not None)
        else:
            label_of = self.label_of
            automatic, notes = labelled_names(aorta, lambda points: label_of(pose.in_surface(points)))
        return automatic, final_names(aorta, automatic, self.names), notes

    def _measured(
        self, aorta: RoughVessel, names: dict[int, str], grid_of: Callable[..., SignedDistanceGrid], pose: _Pose
    ) -> tuple[VesselTree, SignedDistanceGrid, tuple[str, ...]]:
        """Centrelines and distance grid, a finer one where the aorta is narrow, and notes on vessels left out."""
        while True:
            self.budget.check_time("measuring distances to its wall")
            grid = fill_chambers(thicken_between_lumens(grid_of(resolution=self.resolution)))
            self.budget.check_time("drawing its centrelines")
            least = max(LEAST_WIDTH, 1.25 * self.resolution)
            tree, left_out = grow_tree(aorta, names, grid, least)
            thinnest = int(np.argmin(tree.root.radius))
            narrowest = float(tree.root.radius[thinnest])
            if narrowest >= least:
                return tree, grid, left_out
            if self.resolution / 2 < _FINEST_GRID:
                break
            self.resolution /= 2
            self.notes.append(f"distances every {1e3 * self.resolution:g} mm: the aorta is narrow")
        if grid.sample(tree.root.points[thinnest]) <= 0:
            place = pose.in_surface(tree.root.points[thinnest]) / self.facts.scale
            raise MeshRefusedError(
                f"the aorta cannot be followed at ({', '.join(f'{x:.4g}' for x in place)}) of the file: its surface is "
                "torn, doubled or badly closed there; repair it, or cut the mesh to the arch and its branches."
            )
        if narrowest < _PASSABLE:
            raise MeshRefusedError(
                f"the aorta narrows to {narrowest * 1e3:.2f} mm of radius, too narrow for a wire "
                f"({_PASSABLE * 1e3:.1f} mm); check the unit, here {self.facts.unit}."
            )
        self.notes.append(f"the aorta narrows to {narrowest * 1e3:.1f} mm of radius")
        return tree, grid, left_out

    def picture(self, reason: str, path: Path) -> Path | None:
        """Draws what came."""
        if self.surface is None or len(self.surface) == 0:
            return None
        lumen_points = np.zeros((0, 3))
        surface = self.surface if self.samples is None else self.samples.points
        if self.cavity is not None:
            lumen_points = self.cavity.origin + np.argwhere(self.cavity.inside) * self.cavity.spacing
        return draw_refusal(surface, lumen_points, f"{self.facts.file}: {reason}", path)
