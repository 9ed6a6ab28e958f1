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

KINDS = (  # of files and folders
    "surface (STL, VTP, VTK, GLB, …), label volume (NIfTI, NRRD, MetaImage, DICOM) or folder with one file a vessel"
)
RESOLUTION = 1e-3  # m, of the distance grid
_LONGEST_NAME = 60  # letters of a name that is made of a path
TEST_SETS = {"unseen", "unseen_arches", "unseen_arches_clutter"}  # of stages, beside anatomies by name
_KEPT = 4  # phantoms of files that a process keeps
_MM = 1e3


@dataclass(frozen=True)
class AnatomyFile:
    """A file or folder with an anatomy, and what is said of it beside its content."""

    path: str
    unit: str | None = None  # of a surface
    # Pairs of a branch's automatic name and one's own, or all names in order from the heart.
    names: tuple[Any, ...] | None = None
    # Pairs of a label of a volume and the name of its vessel; None leaves the label out.
    labels: tuple[tuple[int | str, str | None], ...] | None = None
    ct: str | None = None  # path of the CT that it was segmented from
    transform: str | None = None  # of NIfTI files, the CT's too: "sform" or "qform"
    extend: bool | None = None  # whether branches that the file cuts short are extended; None: they are

    @classmethod
    def of(
        cls, path: str, unit: str | None = None, names: Any = None, labels: Mapping[str, str | None] | None = None,
        **further: Any,
    ) -> AnatomyFile:  # fmt: skip
        """From a mapping or list of names, a mapping of labels whose keys are text, and further fields."""
        pairs = tuple(names.items()) if isinstance(names, Mapping) else names
        numbered = not Path(path).is_dir()  # a folder's labels are names of its files

        def key(label: str) -> int | str:
            return int(label) if numbered and label.isdecimal() else label

        numbers = tuple((key(label), vessel) for label, vessel in labels.items()) if labels else None
        return cls(path, unit, tuple(pairs) if pairs else None, numbers, **further)

    @property
    def name(self) -> str:
        """What the anatomy is called: made of the path, fit for a folder, and no name of the library."""
        from cathsim.anatomy import PHANTOMS
        from cathsim.anatomy.library import seed_in_name

        stem = re.sub(r"(\.seg)?(\.nii\.gz|\.[A-Za-z]+)$", "", Path(self.path).resolve().name)
        name = re.sub(r"[^A-Za-z0-9_.+-]", "_", stem).lstrip("._+-")[:_LONGEST_NAME] or "anatomy"
        taken = name in PHANTOMS or name in TEST_SETS or seed_in_name(name)[1] is not None
        return f"{name}_file" if taken else name

    def load(self, resolution: float = RESOLUTION) -> Phantom:
        """Its phantom, grid nodes `resolution` m apart; a ValueError says why it cannot be imported."""
        return _imported(replace(self, ct=None), resolution)

    def background(self, resolution: float = RESOLUTION) -> XRayScene | None:
        """Its CT, which X-ray images show around its vessels as `load` places them, or None."""
        return None if self.ct is None else _background(self, resolution)


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
        file.path, unit=file.unit, labels=dict(file.labels) if file.labels else None, names=names,
        transform=file.transform, extend=file.extend is not False, resolution=resolution,
    )  # fmt: skip
    return replace(phantom, name=file.name)


@functools.lru_cache(maxsize=1)  # a CT has hundreds of MB
def _background(file: AnatomyFile, resolution: float) -> XRayScene:
    from cathsim.fluoroscopy import ct_scene

    assert file.ct is not None
    return ct_scene(file.ct, file.load(resolution), transform=file.transform)


def load_anatomy(anatomy: str | AnatomyFile) -> Phantom:
    """The phantom of a name, or of a file; a ValueError where there is none such, or it cannot be imported."""
    from cathsim.anatomy import load_phantom

    return load_phantom(anatomy) if isinstance(anatomy, str) else anatomy.load()


def world_point(phantom: Phantom, point_mm: Sequence[float]) -> tuple[float, float, float]:
    """A point, m in the world frame, of one in mm in the axes of a phantom's file; without a file in the world's."""
    place = np.asarray(point_mm, np.float64) / _MM
    if phantom.imported is not None:
        place = np.array(phantom.imported.rotation) @ place + np.array(phantom.imported.offset)
    x, y, z = (float(coordinate) for coordinate in place)
    return x, y, z
