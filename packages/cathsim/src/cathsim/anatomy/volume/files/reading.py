"""Label volumes read from a file or a folder: the part of the lattice that holds vessels, with their names."""

from __future__ import annotations

import contextlib
import importlib
import os
import re
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.parts.vessel_parts import is_folder_of_parts
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import AORTA, is_other, not_taken, of_one_name, vessel_name
from cathsim.anatomy.volume.dicom.files import is_dicom_file, is_dicom_folder
from cathsim.anatomy.volume.dicom.reading import open_dicom
from cathsim.anatomy.volume.files import metaimage, nifti, nrrd_file
from cathsim.anatomy.volume.files.source import VolumeSource, farthest_apart
from cathsim.anatomy.volume.labels.choice import CELL, Key, LabelChoice, Labels, choose_labels, misfit
from cathsim.guarded_reading import UnreadableFileError, call_in_child, check_regular

SUFFIXES = (*nifti.SUFFIXES, *nrrd_file.SUFFIXES, *metaimage.SUFFIXES)
FORMATS = "NIfTI, NRRD, MetaImage or DICOM (SEG, RTSTRUCT)"
_MOST_LITRES = 5.0  # of all vessels together
_MOST_VOXELS = 2.5e8  # of the box around them
_MOST_TAKEN = 60_000_000  # voxels of vessels
_MOST_LABEL = 65_535
_SAME_LATTICE = 0.5  # of a voxel by which corners of two files of one patient may lie apart
_SECONDS = 300.0  # that a volume may take to be read
# Share of neighbouring labelled voxels with the same label: nearly all, but 1 / n in noise of n labels.
_LEAST_ALIKE = 0.25
_ENOUGH_PAIRS = 10_000

Array = NDArray[np.float64]
Name = TypeVar("Name", bound=Hashable)
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class LabelVolume:
    """Vessels on a lattice of voxels: the box around them."""

    vessels: NDArray[np.uint8]  # (nx, ny, nz) number of the vessel in `names` and 1, 0 where there is none
    names: tuple[str, ...]  # of the vessels
    affine: Array  # (4, 4) from a voxel's indices in the box to the file's world, m
    first: tuple[int, int, int]  # indices of the box's first voxel in the volume
    shape: tuple[int, int, int]  # voxels of the volume
    frame: Array  # (3, 3) rows are the patient's left, posterior and superior axis in the file's world
    file: str
    unit: str  # of the file's world
    metres: float  # m per that unit
    scheme: str  # where names come from
    named: bool
    notes: tuple[str, ...]

    @property
    def spacing(self) -> Array:
        """(3,) m between voxels along the volume's axes."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)

    @property
    def voxel_volume(self) -> float:
        """m^3."""
        return abs(float(np.linalg.det(self.affine[:3, :3])))


def is_volume_path(path: str | Path) -> bool:
    """Whether a path is that of a volume's file, or of a folder that holds some, not beside surfaces of its vessels."""
    path = Path(path).expanduser()
    if path.name.lower().endswith(SUFFIXES) or is_dicom_file(path):
        return True
    if not os.path.isdir(path):
        return False
    volumes = volume_files(path)
    if volumes and not any(vessel_name(file_stem(file)) for file in volumes) and is_folder_of_parts(path):
        return False  # a CT, say, beside the surfaces that were made from it
    return bool(volumes) or is_dicom_folder(path)


def volume_files(folder: Path) -> list[Path]:
    """Files of volumes in a folder, by name."""
    return sorted(p for p in folder.iterdir() if p.name.lower().endswith(SUFFIXES) and not p.name.startswith("."))


def open_volume(path: Path, transform: str | None = None, *, image: bool = False) -> VolumeSource:
    """Reads a volume's header.

    Args:
        path: of its file, or of a folder of DICOM files.
        transform: of a NIfTI file, "sform" or "qform": which of its affines is taken.
        image: whether of DICOM files the CT is wanted, and not labels.

    Raises:
        MeshRefusedError: it is damaged, or no volume.
    """
    if not path.exists():
        raise MeshRefusedError(f"there is no file {path}; give a file in {FORMATS} format, or a folder of them.")
    name = path.name.lower()
    if path.is_dir() or is_dicom_file(path):
        _refuse_transform(path, transform)
        return open_dicom(path, image=image)
    if check_regular(path) == 0:
        raise MeshRefusedError(f"{path.name} is empty; export it again.")
    if name.endswith((*nrrd_file.SUFFIXES, *metaimage.SUFFIXES)):
        _refuse_transform(path, transform)
        return nrrd_file.open_nrrd(path) if name.endswith(nrrd_file.SUFFIXES) else metaimage.open_metaimage(path)
    return nifti.open_nifti(path, transform)


def _refuse_transform(path: Path, transform: str | None) -> None:
    if transform is not None:
        raise MeshRefusedError(f"{path.name} has one affine; transform={transform!r} belongs to NIfTI files.")


def in_child(function: Callable[..., Result], path: Path, *arguments: Any) -> Result:
    """What a reader of volumes returns, called in a process of its own, with limits of memory and time.

    Raises:
        MeshRefusedError: it was refused, crashed or took too much.
    """
    name = path.name.lower()
    kinds = {"nibabel": nifti.SUFFIXES, "nrrd": nrrd_file.SUFFIXES, "SimpleITK": metaimage.SUFFIXES}
    reader = next((module for module, suffixes in kinds.items() if name.endswith(suffixes)), "")
    if path.is_dir():
        reader = "nibabel" if volume_files(path) else "pydicom.pixels"
    with contextlib.suppress(ModuleNotFoundError):
        importlib.import_module(reader or "pydicom.pixels")  # before the process begins, which would do it again
    try:
        return call_in_child(function, path, *arguments, subject=path.name, seconds=_SECONDS)
    except UnreadableFileError as error:
        raise MeshRefusedError(str(error)) from None


def read_labels(path: str | Path, labels: Labels = None, transform: str | None = None) -> LabelVolume:
    """Reads the vessels of a label volume, or of a folder with one file a vessel.

    Args:
        labels: vessel's name by label (its number, its name in the file, or the name of a file of a folder); it
            overrules what the file says.
        transform: of NIfTI files, "sform" or "qform": which of their affines is taken; None: the sform where there is
            one, with a note where the other differs.

    Raises:
        MeshRefusedError: with the reason.
    """
    path = Path(path).expanduser()
    return in_child(_read_labels, path, labels, transform)


def _read_labels(path: Path, labels: Labels, transform: str | None) -> LabelVolume:
    if not path.is_dir() or (is_dicom_folder(path) and not volume_files(path)):
        source = open_volume(path, transform)
        present = _count(source)
        choice = choose_labels(present, source.names, labels, path.name, partial(_misfit, source, present))
        return _box([(source, choice)], path.name, present)
    return _folder(path, labels, transform)


def _misfit(source: VolumeSource, present: dict[Key, int], scheme: str, vessels: dict[Key, str]) -> str:
    """Why a file's labels cannot be a scheme's vessels; empty if they can."""
    turn = source.metres * source.frame @ source.affine[:3, :3]
    places: dict[Key, Array] = {}
    for key, voxels in _collect(source, {key: key for key in vessels}).items():
        cells = np.unique(np.floor(voxels @ turn.T / CELL).astype(np.int32), axis=0)
        places[key] = CELL * (cells.astype(np.float64) + 0.5)
    return misfit(scheme, vessels, places, present)


def file_stem(path: Path) -> str:
    """A volume file's name without its endings."""
    return re.sub(r"(\.seg)?(\.nii\.gz|\.nii|\.nrrd|\.nhdr|\.mha|\.mhd|\.dcm)$", "", path.name, flags=re.IGNORECASE)


def _folder(path: Path, labels: Labels, transform: str | None) -> LabelVolume:
    files: dict[str, Path] = {}
    for file in volume_files(path):
        if other := files.get(file_stem(file)):
            raise MeshRefusedError(f"{other.name} and {file.name} have one name; leave the one that is not meant out.")
        files[file_stem(file)] = file
    if not files:
        raise MeshRefusedError(f"{path} holds no file in {FORMATS} format; give a folder with one file a vessel.")
    names = {(0, number): stem for number, stem in enumerate(files, 1)}
    if labels is None and not any(vessel_name(stem) for stem in files):
        raise MeshRefusedError(
            f"{path.name} has no file that is named after the aorta ({', '.join(list(files)[:8])}); name its files "
            "after vessels, or say which is which by labels={file: 'aorta', ...}."
        )
    choice = choose_labels(dict.fromkeys(names, 1), names, labels, path.name)
    choice = LabelChoice(choice.vessels, "names of the files", named=True, notes=choice.notes)
    parts: list[tuple[VolumeSource, LabelChoice]] = []
    total: Counter[Key] = Counter()
    notes = []
    for key, vessel in choice.vessels.items():
        source = open_volume(files[names[key]], transform)
        present = _count(source)
        if not present:
            if vessel == AORTA:
                raise MeshRefusedError(f"{source.path.name} is empty: all its voxels are zero; export the aorta again.")
            notes.append(f"{source.path.name} is empty")
            continue
        others = {label for label in present if is_other(source.names.get(label, ""))}
        if len(present) > 1:
            text = ", ".join(source.names.get(label, "") or str(label[1]) for label in sorted(present.keys() - others))
            left = ", ".join(source.names[label] for label in sorted(others))
            notes.append(f"{source.path.name} holds labels {text}, taken together" + (f", without {left}" * bool(left)))
            present = {label: count for label, count in present.items() if label not in others}
        total.update(present)
        parts.append((source, LabelChoice(dict.fromkeys(present, vessel), choice.scheme)))
    unused = [stem for key, stem in names.items() if key not in choice.vessels and vessel_name(stem)]
    notes += [f"{stem} is not used" for stem in unused]
    notes += not_taken((stem for key, stem in names.items() if key not in choice.vessels), "files")
    notes += of_one_name((names[key] for key in choice.vessels), "files")
    volume = _box(parts, path.name, dict(total))
    return LabelVolume(**{**vars(volume), "notes": volume.notes + tuple(notes), "named": len(volume.names) > 1})


def _count(source: VolumeSource) -> dict[Key, int]:
    """Voxels of every label that is not zero.

    Raises:
        MeshRefusedError: the values are no labels, or noise.
    """
    counts: Counter[Key] = Counter()
    alike = pairs = 0
    for _, slab in source.slabs():
        for layer, values in enumerate(slab):
            for value, count in zip(*_values(values, source.path.name), strict=True):
                counts[layer, int(value)] += int(count)
            before, after = values[:-1, :, 0], values[1:, :, 0]  # of one slice in each slab: enough to tell noise by
            both = (before != 0) & (after != 0)
            pairs += int(np.count_nonzero(both))
            alike += int(np.count_nonzero(both & (before == after)))
    if pairs >= _ENOUGH_PAIRS and alike < _LEAST_ALIKE * pairs:
        raise MeshRefusedError(
            f"{source.path.name} is noise, or no label volume: of neighbouring voxels that are labelled "
            f"{100 * alike / pairs:.0f} % have the same label; give the segmentation."
        )
    return {key: count for key, count in counts.items() if key[1] != 0}


def _values(values: NDArray, file: str) -> tuple[NDArray, NDArray]:
    """Labels in some values, and how often each is there."""
    if values.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.rint(values)).all()):
        raise MeshRefusedError(
            f"{file} is no label volume: its values are no whole numbers; give the segmentation, not the image."
        )
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    if low < 0 or high > _MOST_LABEL:
        raise MeshRefusedError(
            f"{file} is no label volume: its values run from {low} to {high}; give the segmentation, not the image."
        )
    kind = np.uint8 if high < 256 else np.uint16
    counts = np.bincount(values.astype(kind, copy=False).ravel(order="K"))
    present = np.flatnonzero(counts)
    return present, counts[present]


def _box(parts: list[tuple[VolumeSource, LabelChoice]], file: str, present: dict[Key, int]) -> LabelVolume:
    """The part of the lattice that holds vessels, from one file or several of one lattice."""
    first = parts[0][0]
    names: list[str] = []
    vessel_voxels: list[tuple[NDArray[np.int64], int]] = []  # voxels, and the vessel's number
    voxel = float(np.prod(first.spacing))
    for source, choice in parts:
        shift = _shift(source, first)
        litres = 1e3 * voxel * sum(present.get(key, 0) for key in choice.vessels)
        if litres > _MOST_LITRES:
            raise MeshRefusedError(
                f"{source.path.name} has {litres:.3g} litres labelled as vessels, an aorta with its branches has less "
                "than one; it is noise or another kind of labels: say which labels are vessels by labels=."
            )
        taken = sum(present.get(key, 0) for key in choice.vessels)
        if taken > _MOST_TAKEN:
            raise MeshRefusedError(
                f"{source.path.name} has {taken:,} voxels labelled as vessels, at most {_MOST_TAKEN:,} are taken; it "
                "is noise, or its voxels are finer than any wire needs: save it with larger ones."
            )
        for name in choice.vessels.values():
            if name not in names:
                names.append(name)
        collected = _collect(source, choice.vessels)
        vessel_voxels += [(voxels + shift, names.index(name) + 1) for name, voxels in collected.items()]
    low = np.min([voxels.min(axis=0) for voxels, _ in vessel_voxels], axis=0)
    high = np.max([voxels.max(axis=0) for voxels, _ in vessel_voxels], axis=0) + 1
    if np.prod((high - low).astype(float)) > _MOST_VOXELS:
        raise MeshRefusedError(
            f"the vessels of {file} spread over {np.prod((high - low).astype(float)):.2g} voxels; cut the volume to "
            "them, or save it with larger voxels."
        )
    box = np.zeros(tuple(high - low), dtype=np.uint8)
    # where labels overlap the smaller vessel counts: an aorta's label may run on beneath its branches'
    for voxels, number in sorted(vessel_voxels, key=lambda item: -len(item[0])):
        i, j, k = (voxels - low).T
        box[i, j, k] = number
    affine = first.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ low
    affine[:3] *= first.metres
    choice = parts[0][1]
    corner = (int(low[0]), int(low[1]), int(low[2]))
    notes = (*dict.fromkeys(note for source, _ in parts for note in source.notes), *choice.notes)
    return LabelVolume(
        box, tuple(names), affine, corner, first.shape, first.frame, file, first.unit, first.metres, choice.scheme,
        choice.named, notes,
    )  # fmt: skip


def _collect(source: VolumeSource, vessels: Mapping[Key, Name]) -> dict[Name, NDArray[np.int32]]:
    """Voxels (n, 3) of every vessel in a file, by its name; a vessel may have several labels."""
    pieces: dict[Name, list[NDArray[np.int32]]] = {}
    for start, slab in source.slabs():
        for (layer, value), name in vessels.items():
            voxels = np.argwhere(slab[layer] == value)
            if len(voxels):
                pieces.setdefault(name, []).append((voxels + np.array([0, 0, start])).astype(np.int32))
    return {name: np.concatenate(parts) for name, parts in pieces.items()}


def _shift(source: VolumeSource, first: VolumeSource) -> NDArray[np.int64]:
    """Whole voxels from one volume's lattice to another's.

    Raises:
        MeshRefusedError: the lattices differ.
    """
    turn = np.eye(4)  # from one's world to the other's
    turn[:3, :3] = first.frame.T @ source.frame * (source.metres / first.metres)
    scaled = np.linalg.inv(first.affine) @ turn @ source.affine
    shift = np.rint(scaled[:3, 3])
    moved = np.eye(4)
    moved[:3, 3] = shift
    if farthest_apart(scaled, moved, source.shape) > _SAME_LATTICE:
        raise MeshRefusedError(
            f"{source.path.name} and {first.path.name} lie on different lattices of voxels; export all vessels of one "
            "patient over the same volume."
        )
    return shift.astype(np.int64)
