"""One surface of several closed parts that overlap or touch: the largest of their signed distances is the whole's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.mesh.cavity import Cavity, enclosed_by, falls_apart, find_cavity
from cathsim.anatomy.mesh.distance import distance_grid, lumen_samples, voxels_away
from cathsim.anatomy.mesh.lattice import Budget
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.parts.vessel_parts import Part
from cathsim.anatomy.mesh.reading import Triangles, clean_triangles
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.samples import sample_surface
from cathsim.anatomy.vessel_names import AORTA

_REACH = 3.5e-3  # m around each part within which its distance is measured
_GAPS = (1.0e-3, 2.0e-3, 3.0e-3)  # m between parts that are bridged, the least that joins them
_TORN_OFF = 0.05  # of the largest part: an unnamed one of this size that touches nothing is no dust ...
_AS_WIDE = 0.6  # ... and one of this share of its radius besides may be a part of the aorta that is missing
_SHORT = 0.12  # m: parts up to this length may be looked at on a finer lattice
_ALONG = 3.5  # radii of the narrower part: a longer contact is one of two vessels side by side
_STRANGERS = ({"lsa", "lcca"}, {"rsa", "rcca"}, {"lsa", "rcca"}, {"rsa", "lcca"}, {"rcca", "lcca"}, {"rsa", "lsa"})

Array = NDArray[np.float64]
LabelOf = Callable[[Array], Sequence[str]]


@dataclass(frozen=True, eq=False)
class _Solid:
    """The signed distance to one part."""

    name: str
    grid: SignedDistanceGrid
    low: NDArray[np.int64]  # (3,) index of its first node on the lattice through zero
    radius: float  # m, of the widest ball in it
    volume: float  # m3


def unite(parts: Sequence[Part], spacing: float, budget: Budget) -> tuple[Triangles, LabelOf | None, tuple[str, ...]]:
    """Makes one closed surface of parts (m), with names at places where parts have names, and notes.

    Args:
        parts: each a closed surface, one open at its ends, or a wall around a lumen.
        spacing: m between the nodes on which distances are compared.

    Raises:
        MeshRefusedError: no part encloses anything.
    """
    solids, notes, open_parts = [], [], []
    for part in parts:
        solid = _solid(part, spacing, budget)
        if solid is not None:
            solids.append(solid)
        elif part.name:
            open_parts.append(part.name)
    if not solids:
        raise MeshRefusedError(
            "none of its parts encloses a lumen; expected surfaces of vessels, closed or open at their ends."
        )
    field, low = _joined(solids)
    lost = _bridge(field, low, solids, spacing)
    largest = max(solids, key=lambda solid: solid.volume)
    torn = [solids[k] for k in lost if solids[k].name in ("", AORTA) and solids[k].volume > _TORN_OFF * largest.volume]
    if any(solid.radius > _AS_WIDE * largest.radius for solid in torn):
        whole = max((solid for k, solid in enumerate(solids) if k not in lost), key=lambda solid: solid.volume)
        boxes = [solid.grid.coordinates(solid.grid.inside_box()) for solid in (whole, *torn)]
        raise falls_apart([np.ptp(box, axis=0) for box in boxes])
    if lost:
        left = sorted({solids[k].name or "unnamed" for k in lost})
        notes.append(f"{len(lost)} parts left out, which touch no other: {', '.join(left)}")
    if open_parts:
        notes.append(f"{len(open_parts)} parts left out, which enclose no lumen: {', '.join(sorted(open_parts))}")
    mesh = _surface(field, low, spacing)
    named = [solid for solid in solids if solid.name]
    notes.insert(0, f"united from {len(solids)} parts")
    return mesh, (_Labels(tuple(named)) if named else None), tuple(notes)


@dataclass(frozen=True, eq=False)
class _Labels:
    """Names of the parts that places lie in, or next to."""

    solids: tuple[_Solid, ...]

    def __call__(self, points: Array) -> list[str]:
        distance = np.stack([solid.grid.sample(points) for solid in self.solids])
        # A branch that begins within the aorta is a branch there, too.
        of_aorta = np.array([[1e-6 if solid.name == AORTA else 0.0] for solid in self.solids])
        best = np.argmax(np.where(distance > 0, 1.0, distance) - of_aorta, axis=0)
        near = distance.max(axis=0) > -_REACH
        return [self.solids[int(k)].name if ok else "" for k, ok in zip(best, near, strict=True)]


def _solid(part: Part, spacing: float, budget: Budget) -> _Solid | None:
    mesh, _ = clean_triangles(part.mesh)
    if len(mesh.faces) < 4:
        return None
    mesh = close_openings(mesh)[0]
    cavity: Cavity | None = None
    for finer in (1.0, 0.5):  # short parts are cheap, and narrow ones are lost on a coarse lattice
        if cavity is None and (finer == 1.0 or mesh.extent < _SHORT):
            samples = sample_surface(mesh.corners, 0.7 * finer * spacing, budget)
            try:
                cavity = find_cavity(samples, finer * spacing)
            except MeshRefusedError:  # stout or narrow: no vessel by itself
                continue
    if cavity is None:
        if mesh.extent >= _SHORT:  # it was only looked at on the coarse lattice
            try:
                samples = sample_surface(mesh.corners, 0.7 * finer * spacing, budget)
            except MeshRefusedError:  # its triangles are long: too many points
                finer = 1.0
        cavity = enclosed_by(samples, finer * spacing)
    if cavity is None:
        return None
    away = voxels_away(cavity.inside)
    surface = lumen_samples(samples, cavity, cavity.inside, [], away)
    grid = distance_grid(
        surface,
        cavity,
        cavity.inside,
        [],
        away,
        rotation=np.eye(3),
        offset=np.zeros(3),
        resolution=spacing,
        reach=_REACH,
        exact_within=1.5 * spacing,
        deep=False,
    )
    volume = float(np.count_nonzero(cavity.inside)) * cavity.spacing**3
    return _Solid(part.name, grid, np.rint(grid.origin / spacing).astype(np.int64), cavity.widest, volume)


def _joined(solids: Sequence[_Solid]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    low = np.min([solid.low for solid in solids], axis=0)
    high = np.max([solid.low + solid.grid.shape for solid in solids], axis=0)
    field = np.full(high - low, -_REACH, dtype=np.float32)
    for solid in solids:
        box = _box(solid, low)
        np.maximum(field[box], solid.grid.dense(), out=field[box])
    return field, low


def _box(solid: _Solid, low: NDArray[np.int64]) -> tuple[slice, ...]:
    return tuple(slice(a, a + n) for a, n in zip(solid.low - low, solid.grid.shape, strict=True))


def _bridge(field: NDArray[np.float32], low: NDArray[np.int64], solids: Sequence[_Solid], spacing: float) -> list[int]:
    """Fills the gaps between parts that touch, in place; returns those that touch none."""
    home = next((k for k, s in enumerate(solids) if s.name == AORTA), int(np.argmax([s.radius for s in solids])))
    joined = {home}
    rest = set(range(len(solids))) - joined
    for gap in _GAPS:
        grown = True
        while grown and rest:
            grown = False
            for k in sorted(rest, key=lambda n: -solids[n].radius):
                touching = [j for j in joined if _touch(solids[k], solids[j], gap, spacing, field, low)]
                if touching:
                    joined.add(k)
                    rest.remove(k)
                    grown = True
    for k in rest:  # what hangs on nothing is no lumen of this one
        box = _box(solids[k], low)
        own = solids[k].grid.dense() > 0
        others = np.zeros_like(own)
        for j in joined:
            others |= _values_on(solids[j], solids[k]) > 0
        field[box][own & ~others] = -spacing
    return sorted(rest)


def _values_on(solid: _Solid, other: _Solid) -> NDArray[np.float32]:
    """A part's distance on another one's nodes."""
    values = np.full(other.grid.shape, -_REACH, dtype=np.float32)
    first = np.maximum(solid.low, other.low)
    last = np.minimum(solid.low + solid.grid.shape, other.low + other.grid.shape)
    if (last > first).all():
        other_window = tuple(slice(a, b) for a, b in zip(first - other.low, last - other.low, strict=True))
        window = tuple(slice(a, b) for a, b in zip(first - solid.low, last - solid.low, strict=True))
        values[other_window] = solid.grid.dense((window[0], window[1], window[2]))
    return values


def _touch(
    solid: _Solid, other: _Solid, gap: float, spacing: float, field: NDArray[np.float32], low: NDArray[np.int64]
) -> bool:
    """Whether two parts overlap or touch; a gap is filled, in place, where they end at each other."""
    if {solid.name, other.name} in _STRANGERS:
        return False
    own, theirs = solid.grid.dense(), _values_on(other, solid)
    least = 0.25 * np.pi * (solid.radius / spacing) ** 2 * 2
    if np.count_nonzero((own > 0) & (theirs > 0)) >= max(least, 8):
        return True
    between = np.minimum(own, theirs)
    contact = np.argwhere(between > -gap)
    if len(contact) < max(0.25 * np.pi * (solid.radius / spacing) ** 2, 6):
        return False
    length = float(np.linalg.norm(np.ptp(contact, axis=0))) * spacing
    if length > 2 * _ALONG * min(solid.radius, other.radius) + 2 * gap:
        return False
    box = _box(solid, low)
    np.maximum(field[box], between + np.float32(gap), out=field[box])
    return True


def _surface(field: NDArray[np.float32], low: NDArray[np.int64], spacing: float) -> Triangles:
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(field, level=0.0, spacing=(spacing,) * 3, allow_degenerate=False)
    return Triangles(vertices.astype(np.float64) + low * spacing, np.asarray(faces, dtype=np.int64))
