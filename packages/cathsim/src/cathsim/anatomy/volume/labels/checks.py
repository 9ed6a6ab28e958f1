"""Whether labelled vessels can be a patient's: noise, size, sides, and vessels that the volume cuts lengthwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import AORTA
from cathsim.anatomy.volume.files.reading import LabelVolume
from cathsim.anatomy.volume.labels.choice import sides_exchanged

# Share of a label's faces that are bare, by that of voxels thrown at random into its box: noise has 1, a vessel two
# voxels wide 0.5
_NOISE = 0.6
_SOLID = 0.95  # of a box: a label that fills so much of it is no noise
# m, an aorta's greatest inner radius: a newborn's is 4 mm, an adult's 10 to 20; lumens of aneurysms reach 35
_LEAST_AORTA, _LITTLE_AORTA, _MOST_AORTA = 2.5e-3, 6e-3, 36e-3
_MOST_MEASURED = 8_000_000  # voxels of a box in which depths are measured; larger ones are thinned out
_LENGTHWISE = 2.0  # of a vessel's section, from which on its contact with a face of the volume is no end

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Window = tuple[slice, slice, slice]


def check_labels(volume: LabelVolume) -> tuple[str, ...]:
    """Refuses labels that cannot be an aorta with branches; returns notes on what is doubtful.

    Raises:
        MeshRefusedError: the labels are noise, or their size is no aorta's.
    """
    _refuse_noise(volume.vessels > 0, volume.file, "")
    notes = []
    for number, name in enumerate(volume.names, 1):
        window = _window(volume.vessels, number)
        if window is None:
            continue
        mask = volume.vessels[window] == number
        if name == AORTA:
            _refuse_noise(mask, volume.file, f" of {name}")
        radius = _greatest_radius(mask, volume.spacing, _at_faces(window, volume))
        if name == AORTA:
            notes += _size_notes(radius, volume)
        notes += _cut_notes(mask, window, radius, volume, name)
    if volume.named and (doubt := sides_exchanged(_clouds(volume))):
        notes.append(f"{doubt.replace('would lie', 'lies')}: the affine exchanges sides, or the labels do")
    return tuple(notes)


def _window(box: NDArray[np.uint8], number: int) -> Window | None:
    """The part of a box that holds a vessel."""
    from scipy.ndimage import find_objects

    windows: list[Window] = find_objects((box == number).view(np.uint8))
    return windows[0] if windows else None


def _refuse_noise(mask: Mask, file: str, of: str) -> None:
    """Refuses a label whose voxels have no more neighbours of their own than chance gives them."""
    filled = float(mask.mean())
    pairs = same = 0
    for axis in range(3):
        lower = mask[tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))]
        upper = mask[tuple(slice(1, None) if a == axis else slice(None) for a in range(3))]
        pairs += int(np.count_nonzero(lower)) + int(np.count_nonzero(upper))
        same += 2 * int(np.count_nonzero(lower & upper))
    if filled < _SOLID and pairs and 1 - same / pairs > _NOISE * (1 - filled):
        raise MeshRefusedError(
            f"the label{of} of {file} is noise: {100 * same / pairs:.0f} % of its voxels' neighbours are its own, as "
            "of voxels thrown at random; export the segmentation again, or say which labels are vessels by labels=."
        )


def _at_faces(window: Window, volume: LabelVolume) -> list[tuple[bool, bool]]:
    """Whether a vessel's window reaches the volume's first and its last face along each axis."""
    return [
        (first + side.start == 0, first + side.stop == count)
        for first, side, count in zip(volume.first, window, volume.shape, strict=True)
    ]


def _greatest_radius(mask: Mask, spacing: Array, at_faces: list[tuple[bool, bool]]) -> float:
    """Radius (m) of the largest ball within a vessel, to a voxel or so, as if it went on beyond the volume's faces."""
    from scipy.ndimage import distance_transform_edt

    steps = [1, 1, 1]
    while np.prod([n / s for n, s in zip(mask.shape, steps, strict=True)]) > _MOST_MEASURED:
        steps[int(np.argmin(spacing * steps))] += 1
    thin = mask[tuple(slice(None, None, s) for s in steps)]
    thin = np.pad(thin, 1 if thin.all() else [(int(not low), int(not high)) for low, high in at_faces])
    sides = spacing * steps
    return max(float(distance_transform_edt(thin, sampling=sides).max()) - 0.5 * float(sides.min()), 0.0)


def _size_notes(radius: float, volume: LabelVolume) -> list[str]:
    voxel = " x ".join(f"{1e3 * side:.2g}" for side in volume.spacing)
    sentence = f"the aorta has {1e3 * radius:.2g} mm of radius at its widest, by voxels of {voxel} mm"
    if not _LEAST_AORTA <= radius <= _MOST_AORTA:
        other = "" if radius < _LEAST_AORTA else ", or whether the label holds the heart, too"
        raise MeshRefusedError(
            f"{sentence} in {volume.file}, expected {1e3 * _LEAST_AORTA:g} to {1e3 * _MOST_AORTA:g} (adults have 10 to "
            f"20); check the unit of the file's affine{other}."
        )
    if radius < _LITTLE_AORTA:
        return [f"{sentence}: an infant's, or the unit of the affine is wrong (adults have 10 to 20 mm)"]
    return []


def _cut_notes(mask: Mask, window: Window, radius: float, volume: LabelVolume, name: str) -> list[str]:
    """Notes on faces of the volume that cut a vessel along its path, rather than across its end."""
    from scipy.ndimage import label

    largest = 0.0
    for axis, (begins, ends) in enumerate(_at_faces(window, volume)):
        area = float(np.prod(volume.spacing)) / volume.spacing[axis]
        for at in ([0] if begins else []) + ([-1] if ends else []):
            patches, count = label(np.take(mask, at, axis=axis), np.ones((3, 3)))
            if count:
                largest = max(largest, area * float(np.bincount(patches.reshape(-1))[1:].max()))
    if largest <= _LENGTHWISE * np.pi * max(radius, float(volume.spacing.max())) ** 2:
        return []
    return [f"{name} is cut off lengthwise by the volume's side, which is its wall there over {1e4 * largest:.2g} cm^2"]


def _clouds(volume: LabelVolume) -> dict[str, Array]:
    """Places (n, 3) m of every vessel's voxels: left, posterior and superior."""
    turn = volume.frame @ volume.affine[:3, :3]
    box = volume.vessels
    return {name: np.argwhere(box == n) @ turn.T for n, name in enumerate(volume.names, 1) if name != AORTA}
