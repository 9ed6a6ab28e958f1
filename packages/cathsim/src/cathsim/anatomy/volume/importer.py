"""A phantom from a label volume: NIfTI, NRRD, MetaImage, or a folder with one file a vessel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.completion import final_names, imported_phantom
from cathsim.anatomy.mesh.naming import pose_doubts
from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError, Names, Request, content_digest
from cathsim.anatomy.mesh.surface_import import LEAST_WIDTH, SurfaceFacts, phantom_of_surface
from cathsim.anatomy.mesh.tree import grow_tree
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_names import vessel_name
from cathsim.anatomy.volume.dicom.files import dicom_files
from cathsim.anatomy.volume.files.detached import with_detached_data
from cathsim.anatomy.volume.files.reading import FORMATS, LabelVolume, file_stem, read_labels, volume_files
from cathsim.anatomy.volume.labels.checks import check_labels
from cathsim.anatomy.volume.lumen.labelled import LabelledLumen
from cathsim.anatomy.volume.lumen.smoothing import smooth_vessel
from cathsim.guarded_reading import UnreadableFileError, check_regular

VOLUME_VERSION = 19  # raise it whenever the same volume gives another phantom
_VOLUME_KEPT = 0.03  # share of a vessel's volume by which the phantom's may differ without a note
_LEAST_ML = 1.0  # of a vessel whose volume is compared


_LEAST_CHANGES = 8  # between slices along an axis, that tell how often slices are repeated
_LEAST_PART = 0.5  # of the voxels must hang together


def volume_digest(request: Request) -> str:
    """The hash of the phantom that an import gives: of the files' content and the settings."""
    path = request.path
    if path.is_dir():
        label_names = {str(label) for label, _ in request.labels or ()}
        volumes = volume_files(path)
        files = [f for f in volumes if vessel_name(file_stem(f)) or file_stem(f) in label_names] or dicom_files(path)
    elif path.exists():
        try:
            check_regular(path)
        except UnreadableFileError as error:
            raise MeshRefusedError(str(error)) from None
        files = [path]
    else:
        raise MeshRefusedError(f"there is no file {path}; give a file in {FORMATS} format, or a folder of them.")
    settings: dict[str, Any] = {
        "volume": VOLUME_VERSION, "labels": request.labels, "names": request.names, "resolution": request.resolution,
        "extend": request.extend,
    }  # fmt: skip
    if request.transform is not None:
        settings["transform"] = request.transform
    if path.is_dir():
        settings["files"] = [file.name for file in volume_files(path)]  # notes say which are not taken
    return content_digest(settings, with_detached_data(files), in_folder=path.is_dir())


def build_volume_phantom(request: Request, digest: str) -> Phantom:
    """Builds the phantom of a volume, or of a folder with one a vessel, without any cache.

    Raises:
        MeshRefusedError: with the reason.
    """
    name, names, resolution = file_stem(request.path), request.own_names, request.resolution
    labels = dict(request.labels) if request.labels else None
    volume = join_repeated(read_labels(request.path, labels, request.transform))
    volume = replace(volume, notes=(*volume.notes, *check_labels(volume)))
    if not volume.named:
        return _of_one_piece(volume, name, digest, names, resolution, request.extend)
    lumen = LabelledLumen(volume, resolution)
    grid, aorta, automatic_names, volumes = lumen.build()
    final = final_names(aorta, automatic_names, names)
    least = max(LEAST_WIDTH, 1.25 * resolution)
    tree, left_out = grow_tree(aorta, final, grid, least)
    narrowest = float(tree.root.radius.min())
    if narrowest < least:
        raise MeshRefusedError(
            f"the aorta of {volume.file} narrows to {narrowest * 1e3:.2f} mm of radius, too narrow for a wire "
            f"({least * 1e3:.2f} mm at this resolution); check the labels and the size of the voxels."
        )
    report = ImportReport(
        file=volume.file,
        unit=volume.unit,
        unit_reason="the file's header",
        faces=0,
        kind=f"labels ({volume.scheme})",
        borders=0,
        rotation=volume.frame,
        offset=lumen.world_offset,
        scale=volume.metres,
        axes_kept=True,
        automatic_names={automatic_names[key]: name for key, name in final.items()},
        way_length={},
        notes=(*volume.notes, *pose_doubts(tree.root.points), *lumen.notes, *left_out),
        volumes_ml={name: (round(1e6 * a, 3), round(1e6 * b, 3)) for name, (a, b) in volumes.items()},
    )
    last = _volume_notes(volumes)
    return imported_phantom(tree, grid, report, name=name, digest=digest, extend=request.extend, last_notes=last)


def _volume_notes(volumes: Mapping[str, tuple[float, float]]) -> list[str]:
    voxels, lumen = (sum(pair[n] for pair in volumes.values()) for n in (0, 1))
    notes = []
    if abs(lumen / voxels - 1) > _VOLUME_KEPT:
        notes.append(f"the lumen holds {1e6 * lumen:.4g} ml, its voxels {1e6 * voxels:.4g}")
    for name, (labelled, held) in volumes.items():
        if 1e6 * labelled >= _LEAST_ML and abs(held / labelled - 1) > _VOLUME_KEPT:
            notes.append(f"{name} holds {1e6 * held:.3g} ml, its voxels {1e6 * labelled:.3g}")
    return notes


def _of_one_piece(
    volume: LabelVolume, name: str, digest: str, names: Names, resolution: float, extend: bool
) -> Phantom:
    """A phantom of a lumen whose vessels have no names: they are found by its shape."""
    mesh, notes = lumen_surface_of(volume)
    facts = SurfaceFacts(
        volume.file, volume.unit, "the file's header", len(mesh.faces), volume.metres, (*volume.notes, *notes),
        nameless=volume.scheme in ("one label", "shape"),
    )  # fmt: skip
    phantom = phantom_of_surface(
        mesh, facts, name=name, digest=digest, resolution=resolution, frame=volume.frame, names=names, extend=extend
    )
    assert phantom.imported is not None
    return replace(phantom, imported=replace(phantom.imported, kind=f"labels ({volume.scheme})"))


def join_repeated(volume: LabelVolume) -> LabelVolume:
    """A volume in which voxels that are equal in groups along an axis are one voxel each.

    Labels that a program has copied to finer voxels have steps as high as the voxels before. What smooths them takes
    the height of a step from the size of the voxels, so that thin vessels would fall apart.

    Args:
        volume: labels.

    Returns:
        The same labels on the coarsest lattice that holds them without any change, with a note; the same volume where
        nothing is repeated.
    """
    times = np.array([_repeats(volume, axis) for axis in range(3)])
    if (times == 1).all():
        return volume
    affine = volume.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ ((times - 1) / 2)
    affine[:3, :3] *= times
    sides = " x ".join(f"{1e3 * side:.3g}" for side in np.linalg.norm(affine[:3, :3], axis=0))
    return replace(
        volume,
        vessels=np.ascontiguousarray(volume.vessels[:: times[0], :: times[1], :: times[2]]),
        affine=affine,
        first=_divided(volume.first, times),
        shape=_divided(volume.shape, times),
        notes=(*volume.notes, f"voxels repeat each other, as copying to finer ones does: taken as {sides} mm"),
    )


def _repeats(volume: LabelVolume, axis: int) -> int:
    """How many slices along an axis, counted from the volume's first on, are always equal."""
    slices = np.moveaxis(volume.vessels, axis, 0)
    changes = [i for i in range(1, len(slices)) if not np.array_equal(slices[i - 1], slices[i])]
    if len(changes) < _LEAST_CHANGES:
        return 1
    first = volume.first[axis]
    ends = [first, first + len(slices), volume.shape[axis]]
    return int(np.gcd.reduce([*(first + i for i in changes), *ends]))


def _divided(numbers: tuple[int, int, int], times: NDArray[np.int64]) -> tuple[int, int, int]:
    x, y, z = (int(n) // int(k) for n, k in zip(numbers, times, strict=True))
    return x, y, z


def lumen_surface_of(volume: LabelVolume) -> tuple[Triangles, tuple[str, ...]]:
    """Triangles, m, of the smooth wall around all vessels of a volume, in the file's world; and notes.

    The surface is open where the volume's edge cuts a vessel.

    Raises:
        MeshRefusedError: the labels are noise.
    """
    from scipy.ndimage import label
    from skimage.measure import marching_cubes

    taken = volume.vessels > 0
    parts, count = label(taken, np.ones((3, 3, 3)))
    sizes = np.bincount(parts.reshape(-1))[1:]
    largest = int(np.argmax(sizes)) + 1
    if sizes.max() < _LEAST_PART * sizes.sum():
        raise MeshRefusedError(
            f"the label of {volume.file} is noise: its {int(sizes.sum()):,} voxels lie in {count:,} separate parts; "
            "export the segmentation again, or say which labels are vessels by labels=."
        )
    notes: tuple[str, ...] = ()
    if count > 1:
        notes = (f"{100 * (1 - sizes.max() / sizes.sum()):.2g} % of the labels lies in separate parts and is left out",)
    mask = parts == largest
    edges = tuple((f == 0, f + n == s) for f, n, s in zip(volume.first, mask.shape, volume.shape, strict=True))
    field = smooth_vessel(mask, volume.spacing, continued=edges)
    # cells beyond the volume's faces are left out, and with them the wall across a vessel that a face cuts
    window, origin = [], field.origin.copy()
    for axis, (low, high) in enumerate(edges):
        at = field.origin[axis] + np.arange(field.values.shape[axis]) * field.spacing[axis]
        first = int(np.searchsorted(at, -0.5 * volume.spacing[axis])) if low else 0
        last = int(np.searchsorted(at, (mask.shape[axis] - 0.5) * volume.spacing[axis])) if high else len(at)
        window.append(slice(first, last))
        origin[axis] = at[first]
    values = np.ascontiguousarray(field.values[tuple(window)])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=tuple(field.spacing), allow_degenerate=False)
    axes = volume.affine[:3, :3] / volume.spacing
    world = (vertices + origin) @ axes.T + volume.affine[:3, 3]
    return Triangles(world, faces.astype(np.int64)), notes
