"""Parts of a vessel's label: specks go, gaps are closed, a part that continues another vessel becomes that one's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import PARENTS
from cathsim.lattice.node_set import linked_parts

_LONGEST_GAP = 6e-3  # m between a vessel and its parent, or two parts of one, that is closed
_SPECK = 0.02  # of a vessel: a part of this size is noise
_NOISE = 0.5  # of a vessel must hang together
_MOST_PARTS = 200
_NEAR_GAP = 5e-3  # m around a gap that say how wide the vessel is there
_SLAB, _LEAST_SLAB = 3e-3, 8  # m, and voxels, of the stretches that say where a vessel leads
_RAGGED, _WHOLE = 8e-3, 0.95  # m behind its end within which a vessel has its whole section, and how much of the most
_LEAST_COSINE = 0.4  # of the angle between a vessel and the normal of the wall that it leaves
_ONE_SECTION = 0.5  # of a part's section: a contact with another vessel as wide as this makes it that vessel's
_WITHIN = 0.6  # of the faces of a speck: one with so many to vessels was within them
_HOLES = 1e-7  # m^3 of holes that are worth a note
_OWN_GAP = 3e-3  # m between a part and its own vessel, up to which it is no other's

Array = NDArray[np.float64]
Box = NDArray[np.uint8]


def clean_parts(box: Box, names: Sequence[str], spacing: Array) -> list[str]:
    """Joins the parts of every vessel in a box of labels, in place; returns notes on what was changed.

    Args:
        box: (nx, ny, nz) numbers of vessels, from 1 on, C-contiguous.
        spacing: (3,) m between voxels.

    Raises:
        MeshRefusedError: a label is noise.
    """
    notes: list[str] = []
    labelled = np.flatnonzero(box)
    for number in range(1, len(names) + 1):
        notes += _clean(box, number, names, spacing)
    _fill(box, labelled[box.reshape(-1)[labelled] == 0], _WITHIN)
    filled = _fill(box, _enclosed(box), 1.0)
    if filled * float(np.prod(spacing)) > _HOLES:
        notes.append(f"holes of {1e6 * filled * float(np.prod(spacing)):.2g} ml within the labels are filled")
    return notes


def _clean(box: Box, number: int, names: Sequence[str], spacing: Array) -> list[str]:
    """Keeps the largest part of a vessel and those that a small gap parts from it; others go, or to another vessel."""
    from scipy.ndimage import find_objects, label

    name = names[number - 1]
    region = find_objects((box == number).view(np.uint8))
    if not region:
        return []
    # with what touches it
    crop = box[tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in region[0])]
    parts, count = label(crop == number, np.ones((3, 3, 3)))
    if count <= 1:
        return []
    sizes = np.bincount(parts.reshape(-1))[1:]
    whole = int(sizes.sum())
    if count > _MOST_PARTS and sizes.max() < _NOISE * whole:
        raise MeshRefusedError(
            f"the label of {name} is noise: its {whole:,} voxels lie in {count:,} separate parts; export the "
            "segmentation again, or say which labels are vessels by labels=."
        )
    by_size = np.argsort(-sizes) + 1
    main_parts, notes, dropped = [int(by_size[0])], [], 0
    for part in by_size[1:].tolist():
        if sizes[part - 1] < max(_SPECK * whole, 8):
            dropped += int(sizes[part - 1])
            crop[parts == part] = 0
            continue
        ours = np.argwhere(np.isin(parts, main_parts)) * spacing
        theirs = np.argwhere(parts == part) * spacing
        other = _continued(crop, parts == part, number, spacing) if distances(theirs, ours).min() > _OWN_GAP else 0
        if other and _hang_together(name, names[other - 1]):
            other = 0
        if other:
            crop[parts == part] = other
            notes.append(
                f"{_share(sizes[part - 1], whole)} of {name} is taken for {names[other - 1]}, which it goes on from"
            )
            continue
        gap = bridge(crop, number, ours, theirs, spacing)
        if gap is None:
            dropped += int(sizes[part - 1])
            crop[parts == part] = 0
            notes.append(f"{name} is broken off: {_share(sizes[part - 1], whole)} of it lies too far from the rest")
        else:
            main_parts.append(part)
            notes.append(f"a gap of {1e3 * gap:.1f} mm in {name} is closed")
    if dropped:
        notes.append(f"{_share(dropped, whole)} of {name} lies in separate parts and is left out")
    return notes


def _hang_together(one: str, other: str) -> bool:
    """Whether one vessel usually leaves the other, so that a part of it that touches the other may well be its own."""
    return one in PARENTS.get(other, ()) or other in PARENTS.get(one, ())


def distances(points: Array, to: Array) -> Array:
    """Distance (n,) m of points (n, 3) m to the nearest of others (k, 3) m."""
    from scipy.spatial import cKDTree

    return cKDTree(to).query(points)[0]


def _continued(box: Box, part: NDArray[np.bool_], number: int, spacing: Array) -> int:
    """The other vessel that a part touches over its whole section, 0 where there is none."""
    area = np.prod(spacing) / spacing
    touching = np.zeros(256)
    for axis in range(3):
        for ahead in (False, True):
            own, other = [slice(None)] * 3, [slice(None)] * 3
            own[axis], other[axis] = (slice(None, -1), slice(1, None)) if ahead else (slice(1, None), slice(None, -1))
            touching += area[axis] * np.bincount(box[tuple(other)][part[tuple(own)]], minlength=256)
    touching[[0, number]] = 0.0
    places = np.argwhere(part) * spacing
    length = np.linalg.norm(np.ptp(places, axis=0)) + float(spacing.mean())
    section = len(places) * float(np.prod(spacing)) / length
    return int(np.argmax(touching)) if touching.max() >= _ONE_SECTION * section else 0


def _enclosed(box: Box) -> NDArray[np.int64]:
    """Flat indices of voxels without a label that vessels enclose within their slice across the longest axis."""
    from scipy.ndimage import label

    axis = int(np.argmax(box.shape))
    enclosed = []
    for place in range(box.shape[axis]):
        at: list[int | slice] = [slice(None)] * 3
        at[axis] = place
        gaps, count = label(box[tuple(at)] == 0)
        if count > 1:
            open_gaps = np.unique(np.concatenate([gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]]))
            inner = np.argwhere((gaps > 0) & ~np.isin(gaps, open_gaps))
            enclosed.append(np.insert(inner, axis, place, axis=1))
    places = np.concatenate(enclosed) if enclosed else np.empty((0, 3), dtype=np.int64)
    return np.sort(np.ravel_multi_index(tuple(places.T), box.shape))


def _fill(box: Box, holes: NDArray[np.int64], share: float) -> int:
    """Gives holes to the vessels that they lie within: else each would stand in a wire's way; returns how many voxels.

    Args:
        holes: (n,) flat indices of voxels, ascending.
        share: of a hole's faces that must be vessels'.
    """
    if not len(holes):
        return 0
    places = np.stack(np.unravel_index(holes, box.shape), axis=1)
    flat = box.reshape(-1)
    ends, faces = [], []
    for axis in range(3):
        stride = int(np.prod(box.shape[axis + 1 :], dtype=np.int64))
        for step in (-1, 1):
            rows = np.flatnonzero((places[:, axis] + step >= 0) & (places[:, axis] + step < box.shape[axis]))
            beside = holes[rows] + step * stride
            other = np.minimum(np.searchsorted(holes, beside), len(holes) - 1)
            same = holes[other] == beside
            ends.append(np.stack([rows[same], other[same]]))
            faces.append(np.stack([rows[~same], flat[beside[~same]].astype(np.int64)]))
    pairs, outer = np.concatenate(ends, axis=1), np.concatenate(faces, axis=1)
    which = linked_parts(pairs[0], pairs[1], len(holes))
    around = np.zeros((int(which.max()) + 1, 256), dtype=np.int64)
    np.add.at(around, (which[outer[0]], outer[1]), 1)
    best = np.argmax(around[:, 1:], axis=1) + 1
    within = around[:, 1:].sum(axis=1) >= share * np.maximum(around.sum(axis=1), 1)
    mask = within[which]
    flat[holes[mask]] = best[which[mask]]
    return int(np.count_nonzero(mask))


def _share(part: float, whole: float) -> str:
    return f"{100 * part / whole:.2g} %"


def bridge(
    box: Box, number: int, ours: Array, theirs: Array, spacing: Array, reach: float = _LONGEST_GAP
) -> float | None:
    """Fills the gap between two clouds of voxels (n, 3) m with a tube; returns its length, None if that is too long."""
    from scipy.spatial import cKDTree

    bound = reach + max(_NEAR_GAP, float(spacing.max()))
    away, nearest = cKDTree(theirs).query(ours, distance_upper_bound=bound)
    best = int(np.argmin(away))
    gap = float(away[best])
    if not gap <= reach + float(spacing.max()):
        return None
    near = gap + _NEAR_GAP
    back = cKDTree(ours).query(theirs, distance_upper_bound=near)[0]
    # whole sections, of which balls of that size about the nearest two voxels would hold one side only
    about = near + 2 * min(_usual_radius(ours, spacing), _usual_radius(theirs, spacing))
    ends = []
    for cloud, gaps, place in ((ours, away, theirs[nearest[best]]), (theirs, back, ours[best])):
        ends.append(cloud[(gaps <= near) & (np.linalg.norm(cloud - place, axis=1) <= about)])
    first, last = (end.mean(axis=0) for end in ends)
    # a stretch of a tube of the length 2 s and radius r holds 2 pi r^2 s
    radii = [
        np.sqrt(len(end) * np.prod(spacing) / (np.pi * max(np.ptp(end @ _unit(last - first)), 1e-3))) for end in ends
    ]
    _fill_tube(box, number, first, last, max(min(radii), float(spacing.max())), spacing)
    return gap


def _usual_radius(cloud: Array, spacing: Array) -> float:
    """Radius (m) of a tube as long as a cloud of voxels (n, 3) m and as large."""
    length = float(np.linalg.norm(np.ptp(cloud, axis=0))) + float(spacing.max())
    return float(np.sqrt(len(cloud) * np.prod(spacing) / (np.pi * length)))


def led_on(
    box: Box, number: int, ours: Array, theirs: Array, spacing: Array, least: float = 0.0, most_share: float = 1.0
) -> tuple[float, float] | None:
    """Leads a vessel on along its own axis to another.

    Slabs at two distances from the other vessel have their middles on the axis, however steeply that meets the wall.

    Args:
        least: m of radius that the vessel must have to be led on.
        most_share: of its whole section: a vessel with more of it next to the other is not led on.

    Returns:
        The gap (m) and the vessel's radius (m); None if nothing was done: too long a gap, too wide a contact, or the
        axis misses the other.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(theirs)
    away = tree.query(ours)[0]
    gap = float(away.min())
    if gap > _LONGEST_GAP + float(spacing.max()):
        return None
    slab = max(_SLAB, 1.2 * float(spacing.max()))
    begins = gap + np.arange(0.0, _RAGGED, 0.5e-3)
    counts = np.array([np.count_nonzero((away >= begin) & (away < begin + slab)) for begin in begins])
    if counts[0] > most_share * counts.max():
        return None
    whole = begins[int(np.argmax(counts >= _WHOLE * counts.max()))]
    slabs = [(away >= begin) & (away < begin + slab) for begin in (whole, whole + 2 * slab)]
    if min(np.count_nonzero(mask) for mask in slabs) < _LEAST_SLAB:
        return None
    end, before = (ours[mask].mean(axis=0) for mask in slabs)
    length = float(np.linalg.norm(end - before))
    if not 1.6 * slab <= length <= 2 * slab / _LEAST_COSINE:
        return None  # not one vessel that leads away from the other
    direction = (end - before) / length
    steps = np.arange(0.0, (whole + slab) / _LEAST_COSINE, 0.5e-3)
    met = tree.query(end + steps[:, None] * direction)[0] <= float(spacing.max())
    section = np.count_nonzero(slabs[1]) * float(np.prod(spacing)) / slab  # which cuts the vessel aslant
    radius = float(np.sqrt(section * min(2 * slab / length, 1.0) / np.pi))
    if not met.any() or radius <= least:
        return None
    _fill_tube(box, number, before, end + (steps[int(np.argmax(met))] + radius) * direction, radius, spacing)
    return gap, radius


def _fill_tube(box: Box, number: int, first: Array, last: Array, radius: float, spacing: Array) -> None:
    """Gives what is no vessel's within a radius (m) of a line (3,) m to a vessel."""
    low = np.maximum(np.floor((np.minimum(first, last) - radius) / spacing).astype(int), 0)
    high = np.minimum(np.ceil((np.maximum(first, last) + radius) / spacing).astype(int) + 1, box.shape)
    window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij"), axis=-1)
    offset = points * spacing - first
    along = np.clip(offset @ (last - first) / max(float((last - first) @ (last - first)), 1e-12), 0.0, 1.0)
    inside = np.linalg.norm(offset - along[..., None] * (last - first), axis=-1) <= radius
    part = box[window]
    part[inside & (part == 0)] = number


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
