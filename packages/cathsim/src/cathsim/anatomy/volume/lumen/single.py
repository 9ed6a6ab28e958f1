"""The surface of a lumen that is one label, or of labels without names: vessels are then found by its shape."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import LabelVolume
from cathsim.anatomy.volume.lumen.smoothing import smooth_vessel

_LEAST_PART = 0.5  # of the voxels must hang together


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
            "export "
            "the segmentation again, or say which labels are vessels by labels=."
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
