"""A phantom from a user's mesh: any surface of an aortic arch's lumen or wall, in any unit and pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.anatomy.mesh.lattice import Budget, lattice_spacing
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.parts.union import unite
from cathsim.anatomy.mesh.parts.vessel_parts import Part, read_parts, surface_files
from cathsim.anatomy.mesh.reading import UNITS, Size, clean_triangles, detect_unit, measure_size
from cathsim.anatomy.mesh.report import MeshRefusedError, Request, content_digest, draw_refusal
from cathsim.anatomy.mesh.surface_import import SurfaceFacts, phantom_of_surface
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.pictures.import_picture import vessels_named
from cathsim.anatomy.vessel_names import ACCESS, AORTA

IMPORT_VERSION = 23  # raise it whenever the same file gives another phantom
_MEASURED = 4  # parts whose width is measured for the unit


def surface_digest(request: Request) -> str:
    """The hash of the phantom that an import gives: of the content of its files and the settings.

    Raises:
        MeshRefusedError: a file is missing, too large, no regular file or not of the folder.
    """
    settings: dict[str, Any] = {
        "importer": IMPORT_VERSION, "unit": request.unit, "names": request.names, "resolution": request.resolution,
        "extend": request.extend,
    }  # fmt: skip
    return content_digest(settings, surface_files(request.path), in_folder=request.path.is_dir())


def build_surface_phantom(request: Request, digest: str, picture: Path) -> Phantom:
    """Builds the phantom of a surface, or of a folder of them, without any cache.

    Args:
        picture: PNG file to draw where it is refused.

    Raises:
        MeshRefusedError: with the reason, and where there is something to see the picture.
    """
    path, unit, resolution = request.path, request.unit, request.resolution
    surface = read_parts(path)
    parts, notes = surface.parts, surface.notes
    unit_name, reason = unit, "given"
    try:
        size = _measured(parts)
        if unit_name is None:
            unit_name, reason, unsure = detect_unit(size)
            notes += unsure
        scale = UNITS[unit_name]
        mesh, label_of = parts[0].mesh.scaled(scale), None
        if len(parts) > 1:
            parts = [Part(part.name, part.mesh.scaled(scale)) for part in parts]
            sides = np.ptp([bound for part in parts for bound in part.mesh.bounds], axis=0)
            budget = Budget()
            spacing, _ = lattice_spacing(size.width * scale, sides, resolution, budget, unit_name)
            mesh, label_of, united = unite(parts, spacing, budget)
            notes += united
        phantom = phantom_of_surface(
            mesh,
            SurfaceFacts(path.name, unit_name, reason, surface.faces, scale, notes, size.width * scale),
            name=path.stem,
            digest=digest,
            resolution=resolution,
            frame=surface.frame,
            label_of=label_of,
            names=request.own_names,
            extend=request.extend,
            picture=picture,
        )
        return _with_note_of_lost_parts(phantom, {part.name for part in parts} - {"", *ACCESS})
    except MeshRefusedError as error:
        refusal_picture = error.picture
        if refusal_picture is None:
            centres = np.concatenate([part.mesh.corners.mean(axis=1) for part in parts])
            refusal_picture = draw_refusal(centres, np.zeros((0, 3)), f"{path.name}: {error.reason}", picture)
        reason = error.reason if unit is None else _with_unit_hint(error.reason, parts, unit)
        raise MeshRefusedError(reason, refusal_picture) from None


def _with_note_of_lost_parts(phantom: Phantom, part_names: set[str]) -> Phantom:
    """The phantom, with a note on vessels of which there are parts (by name), but which neither it nor a note has."""
    report = phantom.imported
    assert report is not None
    lost = sorted(part_names - {AORTA, *report.automatic_names})
    lost = [name for name in lost if not any(vessels_named(note, (name,)) for note in report.notes)]
    if not lost:
        return phantom
    note = f"not found, though there are parts of that name: {', '.join(lost)}"
    return replace(phantom, imported=replace(report, notes=(*report.notes, note)))


def _measured(parts: Sequence[Part]) -> Size:
    """The size of the whole, and the width of the widest of its longest parts, in the file's unit."""
    bounds = np.array([bound for part in parts for bound in part.mesh.bounds])
    width, refusal = 0.0, None
    for part in sorted(parts, key=lambda part: -part.mesh.extent)[:_MEASURED]:
        mesh, _ = clean_triangles(part.mesh)
        try:
            if len(mesh.faces) < 4:
                raise MeshRefusedError("the file holds no surface; its faces have no area.")
            width = max(width, measure_size(close_openings(mesh)[0], Budget()).width)
        except MeshRefusedError as error:
            refusal = error
    if width == 0.0 and refusal is not None:
        raise refusal
    return Size(width, float(np.ptp(bounds, axis=0).max()))


def _with_unit_hint(reason: str, parts: Sequence[Part], unit: str) -> str:
    """A refusal under a given unit, with the unit that would fit where another does."""
    try:
        size = _measured(parts)
    except MeshRefusedError:  # there is nothing to measure: the reason says what there is to say
        return reason
    hint = size.hint(unit)
    return f"{reason.rstrip('.')}; {hint}: give that unit, or leave it out." if hint else reason
