"""Centrelines of a lumen given as voxels: its ends, and the ways between them along the lumen's middle.

Ways are shortest paths under a cost that falls with the square of the distance to the wall, so that they keep to the
middle of a vessel whatever its width. Ends are found one after the other, each as the place furthest from all ways so
far (in the manner of TEASAR).

Source: Sato, Bitter, Bender, Kaufman, Nakajima, "TEASAR: tree-structure extraction algorithm for accurate and robust
skeletons", Pacific Graphics 2000.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

_COVER = 1.5  # a way accounts for the lumen within so many radii of it ...
_COVER_MORE = 1e-3  # ... and this, m
_COVER_CLOSELY = 1.15  # as _COVER, where narrow vessels beside a wide one are looked for ...
_RIM = 3.0  # ... of the widest ball's radius: nearer to a tip of the wide part none is looked for
_STUMP = 0.6  # ... of the widest ball's radius: as wide as this they are at most
_LEAST_LENGTH = 7e-3  # m that an end must stand out of what is accounted for
_LEAST_TO_OPENING = 2e-3  # m that it must where the surface is open there, so that a bulge cannot be meant
_MOST_ENDS = 24
_BESIDE_TIP = 3e-3  # m about the tip of a way, besides its vessel's width, in which another way round a ring is sought
_LOOKED_AT = 60  # of the voxels there
_WIDE = 0.55  # of the widest ball's radius: what a ball so wide fits into is the wide part of a lumen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Voxels = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LumenPaths:
    """Shortest ways within a lumen."""

    inside: Mask  # (nx, ny, nz) voxels of the lumen
    origin: Array  # (3,) m, middle of voxel (0, 0, 0)
    spacing: float  # m between voxels

    @cached_property
    def depth(self) -> Array:
        """Distance (nx, ny, nz) m of every voxel to the wall, zero outside."""
        from scipy.ndimage import distance_transform_edt

        return distance_transform_edt(np.pad(self.inside, 1))[1:-1, 1:-1, 1:-1] * self.spacing

    def points(self, voxels: Voxels) -> Array:
        """Middles (..., 3) m of voxels (..., 3)."""
        return self.origin + voxels * self.spacing

    def ends(self, openings: Voxels | None = None) -> Voxels:
        """Voxels (k, 3) at the far ends of the vessels, the first one furthest from the widest place.

        Args:
            openings: voxels (n, 3) of the lumen at openings of its surface, where even a short vessel ends.
        """
        from skimage.graph import MCP_Geometric

        level = np.where(self.inside, 1.0, -1.0)
        widest = np.unravel_index(int(np.argmax(self.depth)), self.inside.shape)
        far = self._farthest(MCP_Geometric(level).find_costs([widest])[0])
        away = MCP_Geometric(level).find_costs([far])[0] * self.spacing
        _, ways = self._costs_and_ways(tuple(far))
        open_ = self.inside & np.isfinite(away)
        ends = [np.array(far)]
        covered = np.zeros_like(self.inside)  # what was looked at
        self._cover(covered, np.array([far]))
        led_to = covered.copy()  # what ways to ends account for

        def beyond(candidate: Voxels, known: Mask) -> tuple[Voxels, float]:
            """The part of the way to a place beyond what is known, and how far the place stands out of it, m."""
            way = _beyond(np.array(ways.traceback(tuple(candidate))), known)
            return way, float(away[tuple(candidate)] - away[tuple(way[0])])

        for candidate in self._farthest_first(open_, away, covered):
            way, stands_out = beyond(candidate, covered)
            self._cover(covered, way)
            covered[tuple(candidate)] = True
            if stands_out >= _LEAST_LENGTH:
                ends.append(candidate)
                self._cover(led_to, way)
            if len(ends) == _MOST_ENDS:
                break
        self._add_stumps(ends, led_to, away, ways)
        for candidate in np.empty((0, 3), int) if openings is None else openings:
            if open_[tuple(candidate)] and not led_to[tuple(candidate)] and len(ends) < _MOST_ENDS:
                way, stands_out = beyond(candidate, led_to)
                if stands_out >= _LEAST_TO_OPENING:
                    ends.append(candidate)
                    self._cover(led_to, way)
        return np.array(ends)

    def _add_stumps(self, ends: list[Voxels], led_to: Mask, away: Array, ways: MCP_Geometric) -> None:  # type: ignore[name-defined]  # noqa: F821
        """Adds the ends of narrow vessels that are cut off so near to a wide one that they lie in what it covers."""
        covered = np.zeros_like(self.inside)
        for end in ends:
            self._cover(covered, np.array(ways.traceback(tuple(end))), _COVER_CLOSELY)
        widest = float(self.depth.max())
        left = self.inside & np.isfinite(away)
        for tip in self.wide_tips[0]:  # the rim of an end that is cut aslant stands out as well
            far = np.sqrt(
                sum((axis - x) ** 2 for axis, x in zip(np.ogrid[tuple(map(slice, left.shape))], tip, strict=True))
            )
            left &= far * self.spacing > _RIM * widest
        for candidate in self._farthest_first(left, away, covered):
            if len(ends) == _MOST_ENDS:
                break
            beyond = _beyond(np.array(ways.traceback(tuple(candidate))), covered)
            stands_out = float(away[tuple(candidate)] - away[tuple(beyond[0])])
            self._cover(covered, beyond, _COVER_CLOSELY)
            covered[tuple(candidate)] = True
            if stands_out >= _LEAST_LENGTH and self.depth[tuple(beyond.T)].max() < _STUMP * widest:
                ends.append(candidate)
                self._cover(led_to, beyond)

    @staticmethod
    def _farthest_first(places: Mask, away: Array, covered: Mask) -> Iterator[Voxels]:
        """The places, the farthest first, that are not covered by the time that it is their turn."""
        order = np.flatnonzero(places)
        order = order[np.argsort(-away.ravel()[order], kind="stable")]
        known = covered.flat
        for index in order.tolist():
            if not known[index]:
                yield np.array(np.unravel_index(index, places.shape))

    @cached_property
    def wide_tips(self) -> tuple[Voxels, float]:
        """Both tips of the lumen's wide part, voxels (2, 3), and the radius, m, of the ball that fits everywhere in it.

        A narrow vessel that leaves a wide one just before its end hides that end from `ends`.
        """
        from scipy.ndimage import distance_transform_edt, label
        from skimage.graph import MCP_Geometric

        widest = np.unravel_index(int(np.argmax(self.depth)), self.inside.shape)
        radius = _WIDE * float(self.depth[widest])
        labels, _ = label(self.depth >= radius)
        from_core = distance_transform_edt(labels != labels[widest]) * self.spacing
        level = np.where(self.inside & (from_core <= radius), 1.0, -1.0)
        first = self._farthest(MCP_Geometric(level).find_costs([widest])[0])
        second = self._farthest(MCP_Geometric(level).find_costs([first])[0])
        return np.array([first, second]), radius

    def ring_tips(self, root: Voxels, ends: Voxels) -> Voxels:
        """Voxels (k, 3) where ways from a root (3,) that go round a ring of vessels meet: one for each way.

        Args:
            ends: voxels (n, 3) that ways lead to anyhow.
        """
        costs, ways = self._costs_and_ways(tuple(root))
        covered = np.zeros_like(self.inside)
        for end in ends:
            self._cover(covered, np.array(ways.traceback(tuple(end))))
        tips: list[Voxels] = []
        for candidate in self._farthest_first(self.inside & np.isfinite(costs), costs, covered):
            way = np.array(ways.traceback(tuple(candidate)))
            beyond = _beyond(way, covered)
            self._cover(covered, beyond)
            covered[tuple(candidate)] = True
            if self._length(beyond) >= _LEAST_LENGTH and self._is_round(way, ways):
                tips.append(candidate)
            if len(tips) == _MOST_ENDS:
                break
        return np.array(tips, dtype=np.int64).reshape(-1, 3)

    def _is_round(self, way: Voxels, ways: MCP_Geometric) -> bool:  # type: ignore[name-defined]  # noqa: F821
        """Whether the lumen next to the last voxel of a way is reached from the root by quite another way, too."""
        from scipy.ndimage import label

        tip = way[-1]
        reach = 2 * float(self.depth[tuple(way[-8:].T)].max()) + _BESIDE_TIP
        count = round(reach / self.spacing)
        low = np.maximum(tip - count, 0)
        part, _ = label(self.inside[tuple(slice(a, b + count + 1) for a, b in zip(low, tip, strict=True))])
        near = np.argwhere(part == part[tuple(tip - low)]) + low
        for voxel in near[:: max(1, len(near) // _LOOKED_AT)]:
            other = np.array(ways.traceback(tuple(voxel)))
            n = min(len(way), len(other))
            apart = np.flatnonzero((way[:n] != other[:n]).any(axis=1))
            fork = int(apart[0]) if len(apart) else n
            if min(self._length(way[fork:]), self._length(other[fork:])) > 3 * reach:
                return True
        return False

    def _length(self, way: Voxels) -> float:
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) * self.spacing

    def ways(self, root: Voxels, ends: Voxels) -> list[Voxels]:
        """Ways (n, 3) of voxels along the lumen's middle from a root (3,) to ends (k, 3), shared until they part."""
        _, ways = self._costs_and_ways(tuple(root))
        return [np.array(ways.traceback(tuple(end))) for end in ends]

    def _farthest(self, away: Array) -> Voxels:
        reached = np.where(self.inside & np.isfinite(away), away, -1.0)
        return np.array(np.unravel_index(int(np.argmax(reached)), self.inside.shape))

    def _costs_and_ways(self, root: tuple[int, ...]) -> tuple[Array, MCP_Geometric]:  # type: ignore[name-defined]  # noqa: F821
        from skimage.graph import MCP_Geometric

        if root not in self._searched:
            cost = np.where(self.inside, (self.spacing / np.maximum(self.depth, self.spacing)) ** 2, -1.0)
            ways = MCP_Geometric(cost)
            self._searched.clear()
            self._searched[root] = ways.find_costs([root])[0], ways
        return self._searched[root]

    @cached_property
    def _searched(self) -> dict[tuple[int, ...], tuple[Array, MCP_Geometric]]:  # type: ignore[name-defined]  # noqa: F821
        """What the last search from a root has found."""
        return {}

    def _cover(self, covered: Mask, way: Voxels, radii: float = _COVER) -> None:
        """Marks the lumen that a way accounts for."""
        for voxel in way[:: max(1, len(way) // 400)]:
            reach = (radii * self.depth[tuple(voxel)] + _COVER_MORE) / self.spacing
            low = np.maximum(np.floor(voxel - reach).astype(int), 0)
            high = np.minimum(np.ceil(voxel + reach).astype(int) + 1, covered.shape)
            i, j, k = np.ogrid[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
            ball = (i - voxel[0]) ** 2 + (j - voxel[1]) ** 2 + (k - voxel[2]) ** 2 <= reach**2
            covered[low[0] : high[0], low[1] : high[1], low[2] : high[2]] |= ball


def _beyond(way: Voxels, known: Mask) -> Voxels:
    """The part of a way (n, 3) from its last voxel on that is known; all of it where none is."""
    inside = np.flatnonzero(known[tuple(way.T)])
    return way[int(inside[-1]) if len(inside) else 0 :]


def resampled(points: Array, step: float) -> Array:
    """A polyline (n, 3) m at even steps (m), at least four points, its ends kept."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    points = points[keep]
    arc = arc_length(points)
    at = np.linspace(0.0, arc[-1], max(round(float(arc[-1]) / step), 3) + 1)
    return np.stack([np.interp(at, arc, points[:, k]) for k in range(3)], axis=1)


def smoothed(points: Array, width: float) -> Array:
    """A polyline (n, 3) m of even steps, smoothed by a Gaussian of deviation `width` (m) along it, its ends kept."""
    from scipy.ndimage import gaussian_filter1d

    if len(points) < 3:
        return points
    step = float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())
    reach = min(len(points) - 1, int(np.ceil(4 * width / step)))
    # Continued by point reflection about its ends: that keeps them in place and their direction.
    before = 2 * points[0] - points[reach:0:-1]
    after = 2 * points[-1] - points[-2 : -reach - 2 : -1]
    longer = np.concatenate([before, points, after])
    smooth: Array = gaussian_filter1d(longer, width / step, axis=0)[reach : reach + len(points)]
    smooth[0], smooth[-1] = points[0], points[-1]
    return smooth


def arc_length(points: Array) -> Array:
    """Arc length (n,) m along a polyline (n, 3) m, zero at its first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def last_direction(points: Array, length: float) -> Array:
    """Unit direction of a polyline's last stretch of a length, m, three points at least."""
    from_end = arc_length(points[::-1])[::-1]
    some = points[from_end <= length]
    some = some if len(some) >= 3 else points[-3:]
    _, _, axes = np.linalg.svd(some - some.mean(axis=0), full_matrices=False)
    return axes[0] * np.sign(axes[0] @ (some[-1] - some[0]) or 1.0)
