"""Label volumes of phantoms: what a segmentation of a known lumen looks like on coarse, oblique voxels."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_names import TOTALSEGMENTATOR
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.files.reading import LabelVolume

IDS = {name: number for number, name in TOTALSEGMENTATOR.items()}
THICK = (0.7e-3, 0.7e-3, 2.5e-3)  # m
_MARGIN = 4e-3  # m around the lumen
_FORK = 3e-3  # m by which daughters go before their trunk beyond its end

Array = NDArray[np.float64]


def oblique() -> Array:
    """Columns of a volume's axes in the patient's: turned about the third, with the second tipped."""
    a, b = 0.3, 0.2
    first = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return first @ np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])


def tubes() -> NDArray[np.uint8]:
    """Labels of an upright vessel (52) and of one that leaves it (58)."""
    labels = np.zeros((40, 36, 30), dtype=np.uint8)
    labels[10:20, 10:20] = 52
    labels[20:30, 13:17, 14:18] = 58
    return labels


def whole_lattice(volume: LabelVolume) -> NDArray[np.uint8]:
    """Numbers (nx, ny, nz) of the vessels on the whole lattice of a volume, which keeps a window of it."""
    labels = np.zeros(volume.shape, dtype=np.uint8)
    window = tuple(slice(a, a + n) for a, n in zip(volume.first, volume.vessels.shape, strict=True))
    labels[window] = volume.vessels
    return labels


def rasterise(
    phantom: Phantom,
    spacing: tuple[float, float, float] = THICK,
    turn: Array | None = None,
    ids: Mapping[str, int] = IDS,
    cut: float = 0.0,
) -> tuple[NDArray[np.uint8], Array]:
    """Labels (nx, ny, nz) of a phantom's lumen, and the affine (4, 4) to right, anterior, superior, mm.

    Columns of `turn` are the volume's axes in the patient's (left, posterior, superior); `cut` m of the lower end are
    left out.
    """
    axes = np.eye(3) if turn is None else turn
    low, high = phantom.bounds
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T @ axes
    first, last = corners.min(axis=0) - _MARGIN, corners.max(axis=0) + _MARGIN
    first[2] += cut + _MARGIN if cut else 0.0
    shape = np.ceil((last - first) / spacing).astype(int)
    labels = np.zeros(shape, dtype=np.uint8)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    for some in np.array_split(np.arange(len(index)), len(index) // 400_000 + 1):
        points = (first + index[some] * spacing) @ axes.T
        inside = phantom.grid.sample(points) > 0
        labels.reshape(-1)[some[inside]] = _labelled(phantom, points[inside], ids)
    affine = np.eye(4)
    flip = np.diag([-1.0, -1.0, 1.0])
    affine[:3, :3] = 1e3 * flip @ axes * np.array(spacing)
    affine[:3, 3] = 1e3 * flip @ axes @ first
    return labels, affine


def _labelled(phantom: Phantom, points: Array, ids: Mapping[str, int]) -> NDArray[np.uint8]:
    found = np.zeros(len(points), dtype=np.uint8)
    best = np.full(len(points), -1.0)
    taken = np.zeros(len(points), dtype=bool)
    for branch in phantom.tree:  # what lies in a parent's tube is the parent's
        _, arc, away = nearest_on_branch(branch, points)
        inside = branch.radius_at(arc) - away
        if branch.parent is not None and not branch.open_end:
            inside = np.where(arc >= branch.length - 1e-6, inside - _FORK, inside)
        better = (inside > best) & ~taken
        best[better], found[better] = inside[better], ids[branch.name]
        taken |= inside > 0
    return found


def save_nifti(path: Path, labels: NDArray, affine: Array, names: Mapping[int, str] | None = None) -> Path:
    """Writes a NIfTI file, with names of labels in its header where there are some."""
    import nibabel

    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units("mm")
    if names:
        rows = "".join(f'<Label Key="{key}" Red="1"><![CDATA[{name}]]></Label>' for key, name in names.items())
        text = f'<?xml version="1.0"?><CaretExtension><VolumeInformation><LabelTable>{rows}</LabelTable>'
        text += "</VolumeInformation></CaretExtension>"
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, text.encode()))
    nibabel.save(image, path)
    return path


def save_slicer(path: Path, labels: NDArray, affine: Array, names: Mapping[int, str]) -> Path:
    """Writes a .seg.nrrd file as 3D Slicer does: space LPS, segments by name."""
    import nrrd

    flip = np.diag([-1.0, -1.0, 1.0])
    header = {
        "space": "left-posterior-superior",
        "space directions": (flip @ affine[:3, :3]).T,
        "space origin": flip @ affine[:3, 3],
        "kinds": ["domain"] * 3,
        "encoding": "gzip",
    }
    for number, (value, name) in enumerate(names.items()):
        header |= {f"Segment{number}_Name": name, f"Segment{number}_LabelValue": str(value)}
    nrrd.write(str(path), labels, header)
    return path
