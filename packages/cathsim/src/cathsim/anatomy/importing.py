"""Anatomies from files: surfaces, label volumes, and folders of them; the half of `load_phantom` that reads files."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from cathsim.anatomy.dual_device_nav import (
    NAME,
    build_published_phantom,
    is_published,
    published_digest,
    with_published_entry,
)
from cathsim.anatomy.mesh.importer import build_surface_phantom, surface_digest
from cathsim.anatomy.mesh.reading import FORMATS as SURFACES
from cathsim.anatomy.mesh.reading import check_unit, converter, is_mesh_path
from cathsim.anatomy.mesh.report import MeshRefusedError, Names, Request, check_resolution
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.phantom_cache import PhantomCache, default_cache_directory
from cathsim.anatomy.pictures.import_picture import with_picture_of_doubts
from cathsim.anatomy.volume.files.nifti import TRANSFORMS
from cathsim.anatomy.volume.files.reading import FORMATS as VOLUMES
from cathsim.anatomy.volume.files.reading import file_stem, is_volume_path
from cathsim.anatomy.volume.importer import build_volume_phantom, volume_digest
from cathsim.anatomy.volume.labels.choice import Labels

_one_at_a_time = threading.Lock()  # an import takes much memory


def is_anatomy_path(name: str) -> bool:
    """Whether a phantom's name is the path of an anatomy: it ends like a file of one, or is a folder."""
    return is_mesh_path(name) or is_volume_path(name)


def import_anatomy(
    path: str | Path,
    *,
    unit: str | None = None,
    labels: Labels = None,
    names: Names = None,
    transform: str | None = None,
    extend: bool = True,
    resolution: float = 1e-3,
    cache_dir: Path | None = None,
) -> Phantom:
    """Makes a phantom of a patient's anatomy; cached by content.

    Args:
        path: the surface of a lumen, or of a thick-walled model of one, in an STL, OBJ, PLY, OFF, VTP, VTK or GLB file;
            a label volume; a folder with one such file a vessel, named after it; or the folder of DualDeviceNav's
            vessels.
        unit: of a surface, "m", "cm", "mm" or "inch"; detected from the vessels' width where it is left out. A volume's
            header has its own.
        labels: which label of a volume is which vessel, by its number, by its name in the file, or by a folder's file
            without its ending; None leaves a label out. It overrules names in the file and published numbers.
        names: names of the user's own: a mapping from the names that were found, or a list for the aorta's branches
            from the heart on.
        transform: of a volume in NIfTI files, "sform" or "qform": which of their affines is taken; None: the sform
            where there is one, with a note where the qform differs.
        extend: branches that end less than 35 mm behind their ostium, cut by the file, are extended to that by a
            straight tube; False: they are left as they are.
        resolution: m between lattice points of the distance grid; half of it for a child's vessels.
        cache_dir: where built phantoms are kept; by default $CATHSIM_CACHE, else the user's cache directory.

    Returns:
        The phantom, in the patient's axes as the file has them, or as far as the vessels show them;
        `phantom.imported` is the account of the import.

    Raises:
        MeshRefusedError: a ValueError with the reason, and where there is something to see a picture.
        ValueError: for an impossible resolution, or an argument that the kind of file does not take.
    """
    request = _request(path, unit, labels, names, transform, extend, resolution)
    directory = default_cache_directory() if cache_dir is None else Path(cache_dir)
    with _one_at_a_time:
        return _load(request, _digest(request), directory)


def import_digest(source: Mapping[str, Any], resolution: float) -> str:
    """The hash of the phantom that an import gives.

    Args:
        source: the other arguments of `import_anatomy`, as JSON holds them.
    """
    return _digest(_request(**_arguments(source), resolution=resolution))


def import_again(source: Mapping[str, Any], resolution: float) -> Phantom:
    """The phantom of an import that was made before; arguments as of `import_digest`."""
    return import_anatomy(**_arguments(source), resolution=resolution)


def _arguments(source: Mapping[str, Any]) -> dict[str, Any]:
    names = source.get("names") or ()
    own = names if all(isinstance(one, str) for one in names) else dict(names)
    return {**source, "names": own, "labels": dict(source.get("labels") or ())}


def _request(
    path: str | Path, unit: str | None = None, labels: Labels = None, names: Names = None, transform: str | None = None,
    extend: bool = True, resolution: float = 1e-3,
) -> Request:  # fmt: skip
    path, kind = Path(path).expanduser(), "mesh"
    name = path.name or str(path)
    if is_published(path):
        if unit or labels or names or transform:
            raise MeshRefusedError(f"{name} is known with its unit, pose and names; leave them out.")
    elif is_volume_path(path):
        kind = "volume"
        if unit is not None:
            raise MeshRefusedError(f"{name} has its unit in its header and takes none; leave unit={unit!r} out.")
        if transform not in (None, *TRANSFORMS):
            raise ValueError(f"transform must be one of {', '.join(TRANSFORMS)}, got {transform!r}.")
        if labels is not None and not isinstance(labels, Mapping):
            raise MeshRefusedError(f"labels is a mapping such as {{1: 'aorta', 2: 'lsa'}}, got {labels!r}.")
    else:
        if path.exists() and not is_mesh_path(path):
            raise MeshRefusedError(
                f"{name} {'holds no file' if path.is_dir() else 'is no file'} of a kind that is read: surfaces are "
                f"{SURFACES} files, label volumes {VOLUMES}; convert it {converter(path)}."
            )
        if labels:
            raise MeshRefusedError(f"{name} is no label volume, it takes no labels; give names instead.")
        if transform is not None:
            raise MeshRefusedError(f"{name} is no label volume; leave transform={transform!r} out.")
        check_unit(unit)
    own = tuple(names.items()) if isinstance(names, Mapping) else tuple(names or ())
    resolution = check_resolution(resolution, kind)
    return Request(path, unit, tuple(labels.items()) if labels else None, own or None, transform, extend, resolution)


def _digest(request: Request) -> str:
    if is_published(request.path):
        return published_digest(request)
    return volume_digest(request) if is_volume_path(request.path) else surface_digest(request)


@lru_cache(maxsize=16)
def _load(request: Request, digest: str, directory: Path) -> Phantom:
    published, volume = is_published(request.path), is_volume_path(request.path)
    name = NAME if published else file_stem(request.path) if volume else request.path.stem
    cache, picture = PhantomCache(directory), f"{name}-{digest[:12]}.png"
    phantom = cache.read(name, digest, None)
    if phantom is None:
        if published:
            phantom = build_published_phantom(request, digest)
        elif volume:
            phantom = build_volume_phantom(request, digest)
        else:
            phantom = build_surface_phantom(request, digest, directory / "refused" / picture)
        phantom = cache.write(with_picture_of_doubts(phantom, directory / "imports" / picture))
    return replace(with_published_entry(phantom) if published else phantom, source=request.to_json())
