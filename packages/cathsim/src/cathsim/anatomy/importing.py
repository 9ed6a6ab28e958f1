"""Anatomies from files: surfaces, label volumes, and folders of them; the half of `load_phantom` that reads files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cathsim.anatomy.mesh.importer import import_mesh, mesh_digest
from cathsim.anatomy.mesh.reading import FORMATS as SURFACES
from cathsim.anatomy.mesh.reading import converter, is_mesh_path
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.request import check_resolution, names_of
from cathsim.anatomy.mesh.surface_import import Names
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.published.dual_device_nav import is_published, load_published, published_digest
from cathsim.anatomy.volume.files.reading import FORMATS as VOLUMES
from cathsim.anatomy.volume.files.reading import is_volume_path
from cathsim.anatomy.volume.importer import import_volume, volume_digest
from cathsim.anatomy.volume.labels.choice import Labels


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
        path: a surface (see `import_mesh`), a label volume, a folder with one volume a vessel (see `import_volume`), or
            the folder of DualDeviceNav's vessels (see `load_published`).
        unit: of a surface; a volume's header has its own.
        labels: which label of a volume is which vessel.
        names: names of the user's own, by automatic name or in order along the arch.
        transform: of a volume in NIfTI files, "sform" or "qform": which of their affines is taken.
        extend: whether branches that the file cuts short are extended (see `import_mesh`).
        resolution: m between lattice points of the distance grid.
        cache_dir: where built phantoms are kept; by default $CATHSIM_CACHE, else the user's cache directory.

    Raises:
        MeshRefusedError: a ValueError with the reason.
        ValueError: for an impossible resolution, or an argument that the kind of file does not take.
    """
    if is_published(Path(path)):
        if unit or labels or names or transform:
            raise MeshRefusedError(f"{Path(path).name} is known with its unit, pose and names; leave them out.")
        return load_published(Path(path), resolution=check_resolution(resolution, "mesh"), cache_dir=cache_dir)
    if not is_volume_path(path):
        if Path(path).exists() and not is_mesh_path(path):
            kind = "holds no file" if Path(path).is_dir() else "is no file"
            raise MeshRefusedError(
                f"{Path(path).name or path} {kind} of a kind that is read: surfaces are {SURFACES} files, label "
                f"volumes {VOLUMES}; convert it {converter(Path(path))}."
            )
        if labels:
            raise MeshRefusedError(f"{Path(path).name} is no label volume, it takes no labels; give names instead.")
        if transform is not None:
            raise MeshRefusedError(f"{Path(path).name} is no label volume; leave transform={transform!r} out.")
        return import_mesh(path, unit=unit, names=names, extend=extend, resolution=resolution, cache_dir=cache_dir)
    if unit is not None:
        raise MeshRefusedError(f"{Path(path).name} has its unit in its header and takes none; leave unit={unit!r} out.")
    return import_volume(
        path,
        labels=labels,
        names=names,
        transform=transform,
        extend=extend,
        resolution=resolution,
        cache_dir=cache_dir,
    )


def import_digest(source: Mapping[str, Any], resolution: float) -> str:
    """The hash of the phantom that an import gives.

    Args:
        source: what a phantom was imported with: path, unit, names and for a volume labels and transform.
    """
    path, names, extend = Path(source["path"]), _tuples(source["names"]), source.get("extend", True)
    if is_published(path):
        return published_digest(path, resolution)
    if is_volume_path(path):
        return volume_digest(path, _tuples(source.get("labels")), names, resolution, source.get("transform"), extend)
    return mesh_digest(path, source["unit"], names, resolution, extend)


def import_again(source: Mapping[str, Any], resolution: float) -> Phantom:
    """The phantom of an import that was made before, by what it was imported with."""
    names, labels = _tuples(source["names"]), _tuples(source.get("labels"))
    return import_anatomy(
        source["path"],
        unit=source["unit"],
        labels=dict(labels) if labels else None,
        names=names_of(names),
        transform=source.get("transform"),
        extend=source.get("extend", True),
        resolution=resolution,
    )


def _tuples(value: Any) -> tuple | None:
    """Lists as JSON holds them, as tuples again."""
    return None if value is None else tuple(one if isinstance(one, str) else tuple(one) for one in value)
