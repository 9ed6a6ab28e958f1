"""The phantoms stage: each aorta as files other programs can read, with its picture and its dimensions."""

from __future__ import annotations

import logging
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from pipeline.anatomies.anatomy_file import AnatomyFile, in_settings
from pipeline.anatomies.settings import FileSettings, require_known_phantoms
from pipeline.settings.kinds import FolderNames, validated
from pipeline.stages import Stage, StageContext
from pipeline.store.atomic_files import atomic_path, read_json, write_json
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Figure, Results

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom, SignedDistanceGrid
    from cathsim.fluoroscopy import XRayScene

_MM = 1e3
PICTURE, IMPORT = "picture.png", "import.json"
RADIOGRAPH, _RADIOGRAPH_PX = "radiograph.png", 512  # with a CT; side of a view
_SLAB = 16  # layers of a grid written at once
COARSEST_RESOLUTION_MM = 2.5  # above it a carotid artery is no longer resolved

_LOGGER = logging.getLogger(__name__)


@validated()
class PhantomsSettings(FileSettings):
    """Settings of the phantoms stage; with a file, its anatomy is the only one."""

    shows_ct: ClassVar[str | None] = "picture"

    name: str = "phantoms"
    phantoms: FolderNames = field(  # named anatomies
        default_factory=lambda: ["type_1", "type_2", "type_1_aneurysm", "low_tortuosity", "type_3", "bovine"]
    )
    resolution_mm: Annotated[float, Ge(0.1), Le(COARSEST_RESOLUTION_MM)] = 1.0  # spacing of the signed distance grid
    wall_thickness_mm: Annotated[float, Ge(0.1), Le(10)] = 1.5
    picture: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is None and not self.phantoms:
            raise ConfigurationError("stage.phantoms is empty: name at least one")


@dataclass(frozen=True)
class Anatomy:
    """One aorta to write: a named phantom, or a file's."""

    label: str
    file: AnatomyFile | None = None


def check_phantoms(settings: PhantomsSettings) -> None:
    """Refuses unknown phantoms, and a file that cannot be imported, with a `ConfigurationError`."""
    if (file := settings.anatomy_file) is None:
        require_known_phantoms(settings.phantoms)
        return
    _LOGGER.info("phantoms: reading %s, a minute for a new file", file.path)
    try:
        file.load(settings.resolution_mm / _MM)
        file.background(settings.resolution_mm / _MM)
    except ValueError as error:
        raise ConfigurationError(f"phantom {file.name} cannot be built: {in_settings(error)}") from error


def run_phantoms(settings: PhantomsSettings, context: StageContext) -> Results:
    anatomies = [Anatomy(name) for name in settings.phantoms]
    if (file := settings.anatomy_file) is not None:
        anatomies = [Anatomy(file.name, file=file)]
    for anatomy in context.folder.resumable(anatomies, key=lambda a: a.label, label="phantoms"):
        try:
            phantom = _build(anatomy, settings)
            background = None if anatomy.file is None else anatomy.file.background(settings.resolution_mm / _MM)
        except ValueError as error:
            raise ConfigurationError(f"phantom {anatomy.label} cannot be built: {in_settings(error)}") from error
        if background is not None and phantom.imported is not None:
            of_ct = tuple(note for solid in background.body for note in getattr(solid, "notes", ()))
            phantom = replace(phantom, imported=replace(phantom.imported, notes=phantom.imported.notes + of_ct))
        folder = context.path / anatomy.label
        write_bundle(phantom, folder, wall_thickness=settings.wall_thickness_mm / _MM, picture=settings.picture)
        if background is not None:
            write_radiograph(phantom, background, folder / RADIOGRAPH)
        context.folder.mark_done(anatomy.label, phantom.dimensions())
    measured = {a.label: context.folder.result_of(a.label) for a in anatomies}
    models = {a.label: {"convex_hulls": "none", "source": "file" if a.file else "parametric"} for a in anatomies}
    figures = [_figure(a, measured[a.label] or {}) for a in anatomies]
    caption = "Contrast run in the patient's CT, from the front and from the side."
    figures += [
        Figure(f"X-ray of {a.label}", caption, f"{a.label}/{RADIOGRAPH}") for a in anatomies if a.file and a.file.ct
    ]
    for anatomy in anatomies:
        _tell(anatomy.label, context.path / anatomy.label)
    return Results({"phantoms": measured, "aortas": models}, figures if settings.picture else None)


def _tell(label: str, folder: Path) -> None:
    """Says what an import left out, assumed or changed, and where the picture is."""
    if (folder / IMPORT).is_file():
        report = read_json(folder / IMPORT)
        _LOGGER.info(
            "%s: unit %s (%s); targets %s",
            label,
            report["unit"],
            report["unit_reason"],
            ", ".join(report["way_length"]),
        )
        for note in report["notes"]:
            _LOGGER.info("%s: note: %s", label, in_settings(note))
    if (folder / PICTURE).is_file():
        _LOGGER.info("%s: picture: %s", label, folder / PICTURE)


def _build(anatomy: Anatomy, settings: PhantomsSettings) -> Phantom:
    from cathsim.anatomy import load_phantom

    resolution = settings.resolution_mm / _MM
    if anatomy.file is not None:
        return anatomy.file.load(resolution)
    return load_phantom(anatomy.label, resolution=resolution)


def _write_grid(grid: SignedDistanceGrid, path: Path) -> None:
    """Writes a grid's values, origin and spacing as NumPy reads them; a large one is never dense in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("values.npy", "w", force_zip64=True) as file:
            np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": grid.shape})
            for first in range(0, grid.shape[0], _SLAB):
                slab = grid.dense((slice(first, first + _SLAB), slice(None), slice(None)))
                file.write(slab.astype("<f4", copy=False).tobytes())
        for name, value in (("origin", grid.origin), ("spacing", np.array(grid.spacing))):
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, value)


def write_bundle(phantom: Phantom, folder: Path, *, wall_thickness: float, picture: bool) -> None:
    """Writes meshes, grid, centrelines, targets and picture of one phantom; `wall_thickness` is in m."""
    with atomic_path(folder / "lumen.stl") as path:
        phantom.lumen_mesh.export(path)
    with atomic_path(folder / "wall.stl") as path:
        phantom.wall_mesh(wall_thickness).export(path)
    with atomic_path(folder / "grid.npz") as path:
        _write_grid(phantom.grid, path)
    write_json(folder / "centrelines.json", {
        branch.name: {"points_m": np.asarray(branch.points).tolist(), "radius_m": np.asarray(branch.radius).tolist()}
        for branch in phantom.tree.branches
    })  # fmt: skip
    write_json(folder / "targets.json", {
        "targets": {t.name: {"position_m": np.asarray(t.position).tolist()} for t in phantom.targets.values()},
        "entries": {
            e.name: {"position_m": np.asarray(e.position).tolist(), "direction": np.asarray(e.direction).tolist()}
            for e in phantom.entries.values()
        },
    })  # fmt: skip
    if phantom.imported is not None:
        write_json(folder / IMPORT, phantom.imported.to_json())
    write_json(folder / "phantom.json", {"name": phantom.name, "hash": phantom.hash, **phantom.dimensions()})
    if picture:
        from cathsim.anatomy.pictures.import_picture import draw_import
        from cathsim.anatomy.pictures.phantom_picture import draw_phantom

        with atomic_path(folder / PICTURE) as path:
            if phantom.imported is None:
                draw_phantom(phantom, path)
            else:
                draw_import(phantom, path)


def write_radiograph(phantom: Phantom, background: XRayScene, path: Path) -> None:
    """Writes a picture of an anatomy's contrast run in its CT, by both C-arms."""
    from cathsim.viewing.display_fluoroscope import contrast_picture
    from cathsim.viewing.opencv import cv2

    with atomic_path(path) as temporary:
        encoded = cv2.imencode(".png", contrast_picture(phantom, _RADIOGRAPH_PX, background))[1]
        temporary.write_bytes(encoded.tobytes())


def _figure(anatomy: Anatomy, measured: dict[str, Any]) -> Figure:
    return Figure(
        title=f"Phantom {anatomy.label}",
        caption=f"{measured.get('branches', 0)} branches, lumen {measured.get('lumen_volume_ml', 0)} mL, aorta "
        f"{measured.get('aorta_length_mm', 0)} mm long.",
        file=f"{anatomy.label}/{PICTURE}",
    )


STAGE = Stage(settings=PhantomsSettings, run=run_phantoms, seeded=False, check=check_phantoms)
