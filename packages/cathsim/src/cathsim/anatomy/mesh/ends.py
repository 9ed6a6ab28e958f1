"""Where a vessel ends: the last plane across it that its wall still surrounds; the lumen is cut flat there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, last_direction, resampled, smoothed
from cathsim.anatomy.distance_grid import across_frames, plane_coordinates
from cathsim.anatomy.mesh.cavity import Cavity
from cathsim.anatomy.mesh.lattice import FOLLOWED
from cathsim.lifetime_cache import kept_with_owner

_RAYS = 48
_SURROUNDED = 0.94  # share of rays across the vessel that must meet its wall
_LOOSELY = (0.8, 0.65)  # shares that do where no place has that: a rim aslant, a torn wall
_REACH = 2.2  # radii within which they must
_PLATEAU = 0.75  # of the largest depth a little further in, at which a vessel counts as having its full width
_CLOSING = 0.4  # of the usual reach: where the wall comes nearer than this, it closes the vessel
_LOOK_BACK = 6e-3  # m, and two radii: how far further in that is
_CENTRING = 6  # steps to the middle of the first plane
_LONGEST = 6  # radii that an end is followed
_BEYOND = 1.75  # radii from the middle of an end to where its way leads: further off the sweep left its vessel
_FLARED = 1.3  # of the radius where the sweep began: where an end is wider, its own says nothing of what is near
_STARTS = (1.5, 2.0, 2.5, 3.0, 1.2)  # depths before the tip of a short vessel at which the sweep begins, in this order
_AT_OPENING = 1.4  # radii, and two voxels, from the end of a way to the middle of the opening that it leads to
_PLAINLY = 0.6  # share of rays that must meet a wall where an end is cut without any sweep
_NEAR = 1.2  # as _BEYOND: as near as this no better end is looked for
_CLEARLY_NEARER = 2e-3  # m
_FURTHER = (2.0, 2.5, 1.5, 3.0, 1.0)  # of its full width's radii before the tip at which the sweep begins anew ...
_STILL_WIDE = 0.7  # ... where the way is still so many of them deep
_SHORT_BEYOND = 1.5  # radii, as _BEYOND, for those
_TILTS = np.linspace(-0.7, 0.7, 9)  # of a direction, as tangents
_FAR_BEYOND = 2.5  # radii beyond which an end that was found otherwise is none, either

Array = NDArray[np.float64]
_GOES_ON = 4.0  # radii: caps reach to at most 2 beyond an end, vessels in a ring to 6 and more


@dataclass(frozen=True, eq=False)
class VesselEnd:
    """A flat end of a vessel."""

    centre: Array  # (3,) m
    normal: Array  # (3,) unit vector out of the vessel
    radius: float  # m, furthest from the centre to the wall across the vessel
    way: Array  # (n, 3) m, the way from the vessel's inside to the centre, at even steps


Refusal = Callable[[VesselEnd], bool]


def find_end(cavity: Cavity, way: Array, depth: Array, refused: Refusal | None = None) -> VesselEnd | None:
    """Follows a vessel to its end; None where its wall surrounds it nowhere.

    Args:
        way: (n, 3) m along the vessel's middle, to somewhere at its end.
        depth: (n,) m, distance to the wall along it.
        refused: whether an end is none of this vessel, as another vessel's.
    """
    for share in (_SURROUNDED, *_LOOSELY):
        end = _find_end(cavity, way, depth, share, refused)
        if end is not None:
            return end
    return _plain_end(cavity, way, depth)


def _plain_end(cavity: Cavity, way: Array, depth: Array) -> VesselEnd | None:
    """A cut across the way where the vessel still has its full width, if walls stand around most of it there."""
    from_end = arc_length(way[::-1])[::-1]
    start = _well_inside(from_end, depth, FOLLOWED * cavity.spacing)
    radius = float(depth[start])
    near = np.flatnonzero((from_end <= 6 * radius) & (from_end >= 0.5 * radius) & (depth >= _STILL_WIDE * radius))
    step = cavity.spacing
    travel = np.arange(step, _REACH * radius, 0.5 * step)
    for index in near[::-1]:
        inner = smoothed(resampled(way[: index + 1], step), radius / 2) if index >= 3 else way[: index + 1]
        if len(inner) < 4:
            break
        normal = last_direction(inner, radius)
        struck, _ = _struck(cavity, inner[-1], normal, travel)
        met = struck.max(axis=1)
        if met.mean() >= _PLAINLY:
            reach = float(np.percentile(travel[np.argmax(struck[met], axis=1)], 90))
            return VesselEnd(inner[-1], normal, max(reach, 2 * step), resampled(inner, step))
    return None


def _find_end(
    cavity: Cavity,
    way: Array,
    depth: Array,
    surrounded: float,
    refused: Refusal | None,
) -> VesselEnd | None:
    from_end = arc_length(way[::-1])[::-1]
    start = _well_inside(from_end, depth, FOLLOWED * cavity.spacing)
    radius = float(depth[start])
    # The way bends to its corner a little before that.
    start = max(int(np.searchsorted(-from_end, -(from_end[start] + radius), side="right")) - 1, min(start, 2))
    first = max(start - 4, min(start, 2))
    end = _followed(cavity, way, first + int(np.argmax(depth[first : start + 1])), radius, surrounded)
    if end is not None and _misses(end, way[-1], refused) <= _NEAR:
        return end
    # Where the vessel bends sharply before it ends, the sweep left it: begin further on.
    for ratio in _FURTHER:
        start = int(np.flatnonzero(from_end >= ratio * radius)[-1]) if (from_end >= ratio * radius).any() else 0
        if depth[start] >= _STILL_WIDE * radius:
            later = _followed(cavity, way, start, float(depth[start]), surrounded)
            if (
                later is not None
                and _misses(later, way[-1], refused) <= _SHORT_BEYOND
                and _further(later, end, way[-1])
            ):
                return later
    if end is not None and _misses(end, way[-1], refused) <= _BEYOND * min(1.0, _FLARED * radius / end.radius):
        return end
    # A short vessel reaches its full width nowhere before it opens into a wider one, and the sweep began in that one.
    for ratio in _STARTS:
        start = int(np.flatnonzero(from_end >= ratio * depth)[-1]) if (from_end >= ratio * depth).any() else 0
        short = _followed(cavity, way, start, float(depth[start]), surrounded)
        if short is not None and _misses(short, way[-1], refused) <= _SHORT_BEYOND:
            return short
    return end if end is not None and _misses(end, way[-1], refused) <= _FAR_BEYOND else None


def end_before(cavity: Cavity, way: Array, depth: Array) -> VesselEnd | None:
    """The end of a wide vessel from which a way goes on in one too narrow to be followed; None where there is none."""
    from_end = arc_length(way[::-1])[::-1]
    least = FOLLOWED * cavity.spacing
    start = _well_inside(from_end, depth, least)
    if len(depth) - start < 3 or np.median(depth[start + 1 :]) >= least:
        return None
    radius = float(depth[start])
    earlier = max(int(np.count_nonzero(from_end > from_end[start] + radius)) - 1, 0)
    return _followed(cavity, way, earlier, radius, _SURROUNDED)


def end_at_opening(
    cavity: Cavity, way: Array, depth: Array, openings: Array, *, flared: bool = False
) -> VesselEnd | None:
    """The end of a vessel at an opening of the surface next to where its way leads; None where there is none.

    Args:
        way: (n, 3) m along the vessel's middle, to somewhere at its end.
        depth: (n,) m, distance to the wall along it.
        openings: (k, 3) m, middles of the surface's openings.
        flared: the vessel is short, and widens all the way to the one that it leaves.
    """
    from_end = arc_length(way[::-1])[::-1]
    start = _well_inside(from_end, depth, FOLLOWED * cavity.spacing)
    radius = float(depth[start])
    if flared:  # its full width is that of the wider vessel that it leaves
        near = (from_end >= 4 * cavity.spacing) & (from_end <= 12 * cavity.spacing)
        radius = float(np.median(depth[near])) if near.any() else radius
        start = int(np.flatnonzero(from_end >= 2 * radius)[-1]) if (from_end >= 2 * radius).any() else 0
    away = np.linalg.norm(openings - way[-1], axis=1)
    if len(away) == 0 or away.min() > _AT_OPENING * radius + 2 * cavity.spacing:
        return None
    opening = openings[int(np.argmin(away))]
    inner = smoothed(resampled(way[: max(start, 3) + 1], cavity.spacing), radius / 2)
    onward = opening - inner[-1]
    length = float(np.linalg.norm(onward))
    along = last_direction(inner, 1.5 * radius)
    if length > 3 * cavity.spacing and onward @ along > 0.5 * length:
        along = onward / length
    centres = [opening - back * cavity.spacing * along for back in (1.5, 2.5, 3.5)]
    centre = next((place for place in centres if cavity.holds(cavity.inside, place)), None)
    if centre is None:
        return None
    track = resampled(np.concatenate([inner, centre[None]]), cavity.spacing)
    return VesselEnd(centre, along, max(1.2 * radius, 2 * cavity.spacing), track)


def straightened(cavity: Cavity, end: VesselEnd) -> VesselEnd:
    """An end whose direction is that in which the vessel is narrowest a radius before it; as it was where none is."""
    back = arc_length(end.way[::-1])[::-1]
    inner = end.way[: max(int(np.count_nonzero(back >= end.radius)), 2)]
    step = 0.5 * cavity.spacing
    travel = np.arange(step, _REACH * end.radius, step)
    first, second = (v[0] for v in across_frames(end.normal[None]))
    best, direction = np.inf, end.normal
    for tilt_a, tilt_b in np.stack(np.meshgrid(_TILTS, _TILTS), axis=-1).reshape(-1, 2):
        normal = end.normal + tilt_a * first + tilt_b * second
        normal /= np.linalg.norm(normal)
        struck, _ = _struck(cavity, inner[-1], normal, travel)
        reach = np.where(struck.max(axis=1), travel[np.argmax(struck, axis=1)], travel[-1])
        reach = np.minimum(reach, 1.3 * np.median(reach))  # openings of other vessels do not count
        if (area := float((reach**2).sum())) < best:
            best, direction = area, normal
    return _swept_end(cavity, inner, direction, end.radius, _SURROUNDED) or end


def severs(end: VesselEnd, way: Array) -> bool:
    """Whether a cut at an end would sever a way (n, 3) m between two ends of the lumen: then it is no end.

    The way must pass through the end and go on for longer than from an end to its corner.
    """
    height, aside = plane_coordinates(way, end.centre, end.normal)
    through = np.flatnonzero((height[1:] > 0) != (height[:-1] > 0))
    for index in through[aside[through] < end.radius]:
        beyond = way[index + 1 :] if height[index + 1] > 0 else way[: index + 1]
        if max(_gap(end, point) for point in (beyond[0], beyond[-1])) > _BEYOND:
            return True
    return False


def goes_on(cavity: Cavity, end: VesselEnd) -> bool:
    """Whether the lumen goes on beyond an end for longer than a cap does, as it does within a ring of vessels."""
    from scipy.ndimage import label

    reach = (_GOES_ON + 1.5) * end.radius + 4 * cavity.spacing
    low, high = cavity.index(end.centre - reach), cavity.index(end.centre + reach)
    axes = [cavity.origin[k] + np.arange(low[k], high[k] + 1) * cavity.spacing for k in range(3)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    height, aside = plane_coordinates(places, end.centre, end.normal)
    cut = (np.abs(height) <= cavity.spacing) & (aside < 1.5 * end.radius)
    part = cavity.inside[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))] & ~cut
    labels, _ = label(part, np.ones((3, 3, 3)))
    next_to_cut = part & (height > cavity.spacing) & (height < 3.5 * cavity.spacing) & (aside < 0.8 * end.radius)
    beyond = part & np.isin(labels, labels[next_to_cut])
    return bool(beyond.any() and np.linalg.norm(places[beyond] - end.centre, axis=1).max() > _GOES_ON * end.radius)


def same_end(end: VesselEnd, other: VesselEnd) -> bool:
    """Whether two ends are one."""
    gap = float(np.linalg.norm(end.centre - other.centre))
    return gap < 0.9 * max(end.radius, other.radius) and float(end.normal @ other.normal) > 0.3


def _misses(end: VesselEnd, tip: Array, refused: Refusal | None) -> float:
    """How far an end lies from where its way leads, in radii; infinite for one that is refused."""
    return float("inf") if refused is not None and refused(end) else _gap(end, tip)


def _further(end: VesselEnd, other: VesselEnd | None, tip: Array) -> bool:
    """Whether an end lies clearly nearer to where its way leads than another one of the same vessel."""
    if other is None or _gap(other, tip) > _BEYOND:
        return True
    end_distance, other_distance = (float(np.linalg.norm(one.centre - tip)) for one in (end, other))
    return end_distance < other_distance - _CLEARLY_NEARER and float(end.normal @ other.normal) > 0.5


def _gap(end: VesselEnd, place: Array) -> float:
    return float(np.linalg.norm(end.centre - place)) / end.radius


def _followed(cavity: Cavity, way: Array, start: int, radius: float, surrounded: float) -> VesselEnd | None:
    """The end of the vessel in which a place of a way lies, None where its wall does not surround it there."""
    step = 0.5 * cavity.spacing
    inner = smoothed(resampled(way[: start + 1], 2 * step), radius / 2) if start >= 2 else way[:2]
    return _swept_end(cavity, inner, last_direction(inner, 1.5 * radius), radius, surrounded)


def _swept_end(cavity: Cavity, inner: Array, direction: Array, radius: float, surrounded: float) -> VesselEnd | None:
    """The end of a vessel that goes on in a direction (3,) from a way (n, 3) m in it; None where none is found."""
    step = 0.5 * cavity.spacing
    centres, normal, reach = _sweep(cavity, tuple(inner[-1]), tuple(direction), radius, step, surrounded)
    if len(centres) < 3:
        return None
    track = resampled(np.concatenate([inner[:-1], np.array(centres)]), 2 * step)
    return VesselEnd(centres[-1], normal, max(reach, 2 * cavity.spacing), track)


def _well_inside(from_end: Array, depth: Array, least: float) -> int:
    """Last point of a way where the vessel has its full width: beyond, the way runs off to a corner of the end."""
    wide = np.flatnonzero(depth >= least)
    for index in reversed(wide.tolist()):
        before = (from_end >= from_end[index]) & (from_end <= from_end[index] + 2 * depth[index] + _LOOK_BACK)
        if depth[index] >= _PLATEAU * depth[before].max():
            return index
    return int(np.argmax(depth))


def _struck(cavity: Cavity, middle: Array, normal: Array, travel: Array) -> tuple[NDArray[np.bool_], Array]:
    """Where rays across a vessel lie in its wall, by ray and travel (m), and the rays' unit vectors (rays, 3)."""
    angles = np.arange(_RAYS) * 2 * np.pi / _RAYS
    first, second = (v[0] for v in across_frames(normal[None]))
    rays = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return cavity.holds(cavity.thick_wall, middle + travel[None, :, None] * rays[:, None, :]), rays


@kept_with_owner
def _sweep(
    cavity: Cavity,
    start: tuple[float, ...],
    direction: tuple[float, ...],
    radius: float,
    step: float,
    surrounded: float,
) -> tuple[list[Array], Array, float]:
    """Goes along a vessel as long as its wall surrounds it: middles (3,) m, last direction, radius m about the last."""
    middle, normal = np.array(start), np.array(direction)
    travel = np.arange(step, _REACH * radius, step)

    def across(middle: Array) -> tuple[Array, float, Array]:
        """Reaches of the rays that met a wall, their share, and the way to the middle between those walls."""
        struck, rays = _struck(cavity, middle, normal, travel)
        met = struck.max(axis=1)
        if not met.any():
            return travel, 0.0, np.zeros(3)
        reach: Array = travel[np.argmax(struck[met], axis=1)]
        shift: Array = np.mean(np.minimum(reach, 1.3 * np.median(reach))[:, None] * rays[met], axis=0)
        return reach, float(met.mean()), shift

    centres: list[Array] = []
    reaches: list[float] = []
    whole, thick = 0, cavity.spacing
    back = max(4, round(radius / step))
    for _ in range(_CENTRING):
        middle = middle + across(middle)[2]
    for _ in range(int(_LONGEST * radius / step)):
        reach, share, shift = across(middle)
        if cavity.holds(cavity.thick_wall, middle) or share < surrounded:
            break
        # The wall's voxels are thickened by one, which counts in a narrow vessel.
        if reaches and reach.min() + thick < _CLOSING * (np.median(reaches[-back:]) + thick):
            break
        middle = middle + min(1.0, 0.5 * step / max(float(np.linalg.norm(shift)), 1e-12)) * shift
        centres.append(middle)
        reaches.append(float(np.percentile(reach, 90)))
        if share == 1.0:
            whole = len(centres)
        if len(centres) > back:
            lately = middle - centres[-1 - back]
            normal = 0.9 * normal + 0.1 * lately / np.linalg.norm(lately)
            normal = normal / np.linalg.norm(normal)
        middle = middle + step * normal
    # A gap in the wall is passed; an opening cut aslant ends where it begins.
    if 0 < len(centres) - whole <= 2 * radius / step:
        centres, reaches = centres[:whole], reaches[:whole]
    return centres, normal, float(np.median(reaches[-back:])) if reaches else 0.0
