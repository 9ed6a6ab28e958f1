"""An anatomy of a file (surface, label volume, folder) with how it is imported, its CT, points in the file's axes."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.fluoroscopy import XRayScene

RESOLUTION = 1e-3  # m, of the distance grid
_LONGEST_NAME = 60  # letters of a name that is made of a path
_KEPT = 4  # phantoms of files that a process keeps
_MM = 1e3


@dataclass(frozen=True)
class AnatomyFile:
    """A file or folder with an anatomy, and what is said of it beside its content.

    Attributes:
        unit: of a surface.
        names: of branches: pairs of an automatic name and one's own, or names from the heart on.
        labels: of a label volume: pairs of a label and a vessel's name, or None.
        ct: path of the CT that it was segmented from.
        transform: of NIfTI files, the CT's too: "sform" or "qform".
        extend: whether branches that the file cuts short are extended.
    """

    path: str
    unit: str | None = None
    names: tuple[Any, ...] | None = None
    labels: tuple[tuple[int | str, str | None], ...] | None = None
    ct: str | None = None
    transform: str | None = None
    extend: bool = True

    @classmethod
    def of(
        cls,
        path: str,
        unit: str | None = None,
        names: Any = None,
        labels: Mapping[str, str | None] | None = None,
        ct: str | None = None,
        transform: str | None = None,
        extend: bool | None = None,
    ) -> AnatomyFile:
        """From a mapping or list of names, and a mapping of labels whose keys are text."""
        pairs = tuple(names.items()) if isinstance(names, Mapping) else names
        numbered = not Path(path).is_dir()  # a folder's labels are names of its files

        def key(label: str) -> int | str:
            return int(label) if numbered and label.isdecimal() else label

        return cls(
            path,
            unit,
            tuple(pairs) if pairs else None,
            tuple((key(label), vessel) for label, vessel in labels.items()) if labels else None,
            ct,
            transform,
            extend is not False,
        )

    @property
    def name(self) -> str:
        """What the anatomy is called: made of the path, fit for a folder, and no name of the library."""
        from cathsim.anatomy import PHANTOMS
        from cathsim.anatomy.library import seed_in_name

        stem = re.sub(r"(\.seg)?(\.nii\.gz|\.[A-Za-z]+)$", "", Path(self.path).resolve().name)
        name = re.sub(r"[^A-Za-z0-9_.+-]", "_", stem).lstrip("._+-")[:_LONGEST_NAME] or "anatomy"
        return f"{name}_file" if name in PHANTOMS or seed_in_name(name)[1] is not None else name

    def load(self, resolution: float = RESOLUTION) -> Phantom:
        """Its phantom, from the cache where it was imported before.

        Args:
            resolution: m between the nodes of its grid.

        Raises:
            ValueError: the file cannot be imported, or not so.
        """
        return _imported(replace(self, ct=None), resolution)

    def room(self) -> XRayScene | None:
        """What X-ray images show around its vessels: its CT; None where there is none.

        Raises:
            ValueError: the file cannot be imported, or the CT is not that of the anatomy.
        """
        return None if self.ct is None else _room(self)


def in_settings(text: object) -> str:
    """A refusal or a note of an import, whose arguments are named as the settings that a command line gives."""
    return re.sub(r"(?<![\w.])(extend|labels|names|transform|unit)=", r"phantom.\1=", str(text))


@functools.lru_cache(maxsize=_KEPT)
def _imported(file: AnatomyFile, resolution: float) -> Phantom:
    from cathsim.anatomy import import_anatomy

    names: Any = file.names
    if names and isinstance(names[0], tuple):
        names = dict(names)
    phantom = import_anatomy(
        file.path,
        unit=file.unit,
        labels=dict(file.labels) if file.labels else None,
        names=names,
        transform=file.transform,
        extend=file.extend,
        resolution=resolution,
    )
    return replace(phantom, name=file.name)


@functools.lru_cache(maxsize=1)  # a CT has hundreds of MB
def _room(file: AnatomyFile) -> XRayScene:
    from cathsim.fluoroscopy import ct_scene

    assert file.ct is not None
    return ct_scene(file.ct, file.load(), transform=file.transform)


def load_anatomy(anatomy: str | AnatomyFile) -> Phantom:
    """The phantom of a name, or of a file.

    Raises:
        ValueError: there is none such, or the file cannot be imported.
    """
    from cathsim.anatomy import load_phantom

    return load_phantom(anatomy) if isinstance(anatomy, str) else anatomy.load()


def world_point(phantom: Phantom, point_mm: Sequence[float]) -> tuple[float, float, float]:
    """A point in m in the world frame.

    Args:
        point_mm: (3,) mm, in the axes of the file that the phantom was imported from; of another phantom in the world
            frame.
    """
    place = np.asarray(point_mm, np.float64) / _MM
    if phantom.imported is not None:
        place = np.array(phantom.imported.rotation) @ place + np.array(phantom.imported.offset)
    x, y, z = (float(coordinate) for coordinate in place)
    return x, y, z
