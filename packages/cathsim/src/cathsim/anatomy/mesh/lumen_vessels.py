"""The ends of all vessels of a lumen, and the vessels between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import LumenPaths, Voxels
from cathsim.anatomy.mesh.aortic_ends import aortic_ends
from cathsim.anatomy.mesh.branches import RoughVessel, build_vessels
from cathsim.anatomy.mesh.cavity import Cavity, largest_part
from cathsim.anatomy.mesh.ends import (
    Refusal,
    VesselEnd,
    end_at_opening,
    end_before,
    find_end,
    goes_on,
    same_end,
    severs,
    straightened,
)
from cathsim.anatomy.mesh.naming import ascending_score
from cathsim.anatomy.mesh.report import MeshRefusedError

_TORN_OFF = 0.03  # of the lumen: a part of this size that no coarse voxel joins to the rest is no speck
_AT_OPENING = 3.0  # coarse voxels between the middle of an opening and the lumen's nearest one
_SHORT_OF = 4e-3  # m before an opening at which an end that was found otherwise may lie
_BESIDE = 1.6  # radii from the middle of an end: a way that leads further off leads elsewhere
_AS_WIDE, _NEAR_TIP = 0.7, 3.0  # of the wide part's radius: what its ends have at least, how near its tips they lie
_NARROW = 0.35  # of a wide vessel's radius: one that may be cut off for the wide one's end
_NARROWER = 0.7  # of a wide vessel's radius: the end of a short one beside it is not wider
_UNCLEAR = 0.25  # a smaller ascending score is not clear

Array = NDArray[np.float64]


def count_rings(cavity: Cavity) -> int:
    """How many rings the vessels of a lumen form, at least: by its Euler number."""
    from skimage.measure import euler_number

    box = tuple(slice(int(at.min()), int(at.max()) + 1) for at in np.nonzero(cavity.inside))
    return max(1 - int(euler_number(cavity.inside[box], 3)), 0)


def find_ends(cavity: Cavity, openings: Array, *, rings: bool = False) -> tuple[list[VesselEnd], tuple[str, ...]]:
    """The ends of all vessels, and notes on those that were given up.

    Args:
        openings: (k, 3) m, middles of the surface's openings.
        rings: vessels form rings, so that a way may lead to where the lumen goes on: there is no end.

    Raises:
        MeshRefusedError: there are fewer than three, so no branch to steer into, or it is no vessel at all.
    """
    from scipy.ndimage import label

    paths = _coarse(cavity, cavity.inside)
    labels, _ = label(paths.inside, np.ones((3, 3, 3)))
    parts = np.sort(np.bincount(labels[paths.inside]))[::-1]
    if parts[1] > _TORN_OFF * parts.sum():
        raise MeshRefusedError(
            f"the lumen narrows to less than {1e3 * paths.spacing:.1f} mm of width between two parts of it, too narrow "
            "for a wire at this resolution; take a finer one, or check the unit."
        )
    voxels = paths.ends(_voxels_at(paths, openings))
    if len(voxels) < 2:
        raise MeshRefusedError("the lumen is no vessel: it has no two ends; expected an aorta with its branches.")
    ways = paths.ways(voxels[0], voxels[1:])
    longest = max(ways, key=len)
    end_ways: list[tuple[VesselEnd, Voxels]] = []
    lost: set[tuple[int, ...]] = set()  # far ends of the ways whose vessel's end is not surrounded, or cut off
    for way in [longest[::-1], *ways]:
        points, depth = paths.points(way), paths.depth[tuple(way.T)]
        end = find_end(cavity, points, depth)
        if end is not None and (others := [o for o, _ in end_ways if same_end(end, o) and _is_beside(o, points[-1])]):
            # A short vessel beside a wide one: what was found is that one's end.
            end = end_at_opening(cavity, points, depth, openings, flared=True)
            end = end or find_end(cavity, points, depth, _one_of(others))
            if end is not None and end.radius > _NARROWER * others[0].radius:
                end = None
        else:
            open_end = end_at_opening(cavity, points, depth, openings)
            if open_end is not None and (end is None or (end.centre - open_end.centre) @ open_end.normal < -_SHORT_OF):
                end = open_end
        if end is None:
            lost.add(_far_end(way))
            end = end_before(cavity, points, depth)
        if rings and end is not None and goes_on(cavity, end):
            continue
        if end is not None and not any(same_end(end, other) for other, _ in end_ways):
            end_ways.append((end, way))
    whole = _whole_ends(cavity, paths, end_ways, ways)
    hidden, uncut_ends = _hidden_ends(cavity, paths, whole, voxels[0])
    ends = [*uncut_ends, *hidden]
    lost |= {_far_end(way) for _, way in end_ways} - {
        _far_end(way) for end, way in whole if any(end is one for one in uncut_ends)
    }
    if len(lost) > len(voxels) // 2:
        raise MeshRefusedError(
            f"no wall surrounds the vessel at {len(lost)} of the lumen's {len(voxels)} ends: loose sheets or spikes "
            "stand in it, or its wall is torn; repair the mesh, or cut it to the arch and its branches."
        )
    if len(ends) < 3:
        raise MeshRefusedError(
            f"the lumen has {len(ends)} ends, an aorta with a branch has at least three; "
            "a vessel without a side branch offers no target."
        )
    if not lost:
        return ends, ()
    return ends, (f"{len(lost)} of {len(voxels)} ends of vessels left out: the wall does not surround them",)


def _whole_ends(
    cavity: Cavity,
    paths: LumenPaths,
    end_ways: Sequence[tuple[VesselEnd, Voxels]],
    ways: Sequence[Voxels],
) -> list[tuple[VesselEnd, Voxels]]:
    """The ends that sever no other way; of a short vessel whose cut would go through a wide one, a nearer one."""
    whole = []
    for end, own in end_ways:

        def severing(other: VesselEnd, own: Voxels = own) -> bool:
            return any(severs(other, paths.points(way)) for way in ways if _leads_elsewhere(way, own))

        if not severing(end):
            whole.append((end, own))
            continue
        of_others = _one_of([one for one, _ in end_ways if one is not end])

        def refused(other: VesselEnd, severing: Refusal = severing, of_others: Refusal = of_others) -> bool:
            return severing(other) or of_others(other)

        nearer = find_end(cavity, paths.points(own), paths.depth[tuple(own.T)], refused)
        if nearer is not None and not refused(nearer):
            whole.append((nearer, own))
    return whole


def _hidden_ends(
    cavity: Cavity,
    paths: LumenPaths,
    end_ways: Sequence[tuple[VesselEnd, Voxels]],
    root: Voxels,
) -> tuple[list[VesselEnd], list[VesselEnd]]:
    """Ends of the wide vessel that others hide, which leave it just before: a coronary artery, the first of the arch.

    Returns:
        Those ends, and the others without those of narrow vessels that a wide one's end cuts off.
    """
    tips, radius = paths.wide_tips
    hidden: list[VesselEnd] = []
    uncut_ways = list(end_ways)
    for tip in tips:
        place = paths.points(tip)
        known = [*(end for end, _ in uncut_ways), *hidden]
        if any(one.radius > _AS_WIDE * radius and _near_tip(one, place, radius) for one in known):
            continue
        (way,) = paths.ways(root, tip[None])
        end = find_end(cavity, paths.points(way), paths.depth[tuple(way.T)], _one_of(known))
        end = None if end is None else straightened(cavity, end)
        if end is None or end.radius < _AS_WIDE * radius or not _near_tip(end, place, radius):
            continue
        cut = [one for one, own in uncut_ways if severs(end, paths.points(own))]
        if all(one.radius < _NARROW * end.radius for one in cut):
            hidden.append(end)
            uncut_ways = [(one, own) for one, own in uncut_ways if not any(one is other for other in cut)]
    return hidden, [end for end, _ in uncut_ways]


def _far_end(way: Voxels) -> tuple[int, ...]:
    return tuple(int(index) for index in way[-1])


def _one_of(ends: Sequence[VesselEnd]) -> Refusal:
    return lambda end: any(same_end(end, other) for other in ends)


def _near_tip(end: VesselEnd, tip: Array, radius: float) -> bool:
    return bool(np.linalg.norm(end.centre - tip) <= _NEAR_TIP * radius)


def _leads_elsewhere(way: Voxels, own: Voxels) -> bool:
    """Whether a way has other ends than the one that an end was found along."""
    return not (np.array_equal(way[0], own[0]) and np.array_equal(way[-1], own[-1]))


def _voxels_at(paths: LumenPaths, places: Array) -> Voxels:
    """The lumen's voxels (k, 3) next to those of some places (n, 3) m that lie at the lumen, the widest first."""
    lumen = np.argwhere(paths.inside)
    if len(places) == 0:
        return lumen[:0]
    from scipy.spatial import cKDTree

    away, nearest = cKDTree(paths.points(lumen)).query(places)
    at = lumen[nearest[away < _AT_OPENING * paths.spacing]]
    return at[np.argsort(-paths.depth[tuple(at.T)], kind="stable")]


def _is_beside(end: VesselEnd, tip: Array) -> bool:
    """Whether a way's last point lies beside the vessel that an end closes."""
    return bool(np.linalg.norm(tip - end.centre) > _BESIDE * end.radius)


def find_vessels(
    cavity: Cavity,
    inside: NDArray[np.bool_],
    ends: list[VesselEnd],
    *,
    rings: bool = False,
    scale: float = 1.0,
    frame: Array | None = None,
) -> tuple[RoughVessel, tuple[str, ...], bool]:
    """The aorta with its branches, from its descending end on, and a note on each end that may be the aorta's, too.

    Vessels of a ring lead to where they meet. The last value is whether the shape does not show which of the aorta's
    ends is the heart's.

    Args:
        scale: m per unit of the file, for the notes.
        frame: (3, 3) rows are the patient's left, posterior and superior axis, where they are known.

    Raises:
        MeshRefusedError: the ends are not of one lumen, or the aorta has no branch.
    """
    paths = _coarse(cavity, inside)
    lumen = np.argwhere(largest_part(paths.inside, np.ones((3, 3, 3))))  # no way leads to the other parts
    at = paths.points(lumen)
    places = []
    for end in ends:
        behind = end.centre - min(0.5 * end.radius, 3e-3) * end.normal
        away = ((at - behind) ** 2).sum(axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] > (end.radius + 4 * cavity.spacing) ** 2:
            raise MeshRefusedError(
                "the lumen falls apart where its ends are cut: its surface is torn, doubled or crosses itself; repair "
                "it, or cut the mesh to the arch and its branches."
            )
        places.append(lumen[nearest])

    def vessels(first: int, last: int) -> RoughVessel:
        others = [n for n in range(len(ends)) if n != first]
        goals = np.array([places[n] for n in others])
        tips = paths.ring_tips(places[first], goals) if rings else goals[:0]
        ways = paths.ways(places[first], np.concatenate([goals, tips]))
        last_points = [*(ends[n].centre for n in others), *paths.points(tips)]
        points = [
            np.concatenate([ends[first].centre[None], paths.points(way)[1:-1], point[None]])
            for point, way in zip(last_points, ways, strict=True)
        ]
        depths = [paths.depth[tuple(way.T)] for way in ways]
        aorta = build_vessels(ways, points, depths, others.index(last))
        for vessel in aorta.every:
            if vessel.end is not None and vessel.end >= len(others):
                vessel.end = -vessel.end
        return aorta

    ways = paths.ways(places[0], np.array(places[1:]))
    depths = [paths.depth[tuple(way.T)] for way in ways]
    first, last, unsure = aortic_ends([paths.points(way) for way in ways], depths, [end.radius for end in ends])
    first, last = sorted((first, last), key=lambda n: ends[n].radius)
    aorta = vessels(first, last)
    score = ascending_score(aorta, ends[first].radius, ends[last].radius)
    unclear = abs(score) < _UNCLEAR
    if unclear and frame is not None:  # the descending end is further to the left and to the back
        score, unclear = float((frame[0] + frame[1]) @ (ends[first].centre - ends[last].centre)), False
    if score < 0:
        aorta = vessels(last, first)
    if not aorta.children:
        raise MeshRefusedError("the aorta has no branch to steer into; expected an aortic arch with its branches.")
    notes = tuple(
        "the aorta may end elsewhere: a vessel as wide as it ends at "
        f"({', '.join(f'{x / scale:.4g}' for x in ends[n].centre)}) of the file"
        for n in unsure
    )
    return aorta, notes, unclear


def _coarse(cavity: Cavity, inside: NDArray[np.bool_]) -> LumenPaths:
    """Every second voxel: fine enough for ways, and eight times as fast."""
    return LumenPaths(np.ascontiguousarray(inside[::2, ::2, ::2]), cavity.origin, 2 * cavity.spacing)
