"""Cross-sections of a vessel: diameter, ellipticity, and how rough its wall is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import smoothed
from cathsim.anatomy.cross_section import across_frames
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.phantom import Phantom

STEP = 1e-3  # m between cross-sections
RAYS = 48
SMOOTHING = 4e-3  # m, deviation of the Gaussian that makes the smoothed wall
_CENTRELINE = 3e-3  # m, deviation of the Gaussian that smooths the line that sections stand across
_RAY_STEP = 7e-4  # m
_END = 4e-3  # m at open ends that are left out: cut aslant or flared
_OSTIUM = 2e-3  # m beyond an ostium's edge that are left out, too
_WIDEST = 1.6  # a ray longer than this many medians of its section looks into a branch

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections of one branch at even steps, those at ends and ostia marked."""

    arc: Array  # (n,) m along the branch
    radius: Array  # (rays, n) m from the centreline to the wall
    sound: NDArray[np.bool_]  # (n,) where the wall was met, if beyond an ostium on some rays
    whole: NDArray[np.bool_]  # (n,) where the section is the branch's own, without an ostium or an end

    @property
    def diameter(self) -> Array:
        """Diameter (n,) m of the circle of the same area."""
        return 2 * np.sqrt((self._clipped() ** 2).mean(axis=0))

    def diameter_at(self, arc: float, width: float = 3e-3) -> float:
        """Median diameter (m) of the sections within a distance (m) of an arc length (m); NaN without any.

        Where none is whole, as between ostia that touch, those with an ostium count, their rays into it cut short.
        """
        near = np.abs(self.arc - arc) <= width
        near &= self.whole if (near & self.whole).any() else self.sound
        return float(np.median(self.diameter[near])) if near.any() else float("nan")

    @property
    def ellipticity(self) -> Array:
        """1 less the ratio of the axes (n,) of the ellipse with the same second moments; 0 of a circle."""
        radius = self._clipped()
        angle = np.arange(len(radius)) * 2 * np.pi / len(radius)
        along = np.stack((np.cos(angle), np.sin(angle)))  # (2, rays)
        area = np.maximum((radius**2).sum(axis=0) / 2, 1e-12)
        middle = np.einsum("kr,rn->kn", along, radius**3) / 3 / area
        second = np.einsum("kr,lr,rn->nkl", along, along, radius**4) / 4 / area[:, None, None]
        second -= np.einsum("kn,ln->nkl", middle, middle)
        least, most = np.linalg.eigvalsh(second).T
        return 1 - np.sqrt(np.maximum(least, 0.0) / np.maximum(most, 1e-18))

    def roughness(self) -> float:
        """Root mean square distance (m) of the wall from the smoothed wall, in whole sections; NaN without any.

        The smoothed wall is the wall's distance from the centreline under a Gaussian of SMOOTHING, along the vessel and
        around it.
        """
        from scipy.ndimage import gaussian_filter, gaussian_filter1d

        stretches = [one for one in np.split(np.arange(len(self.arc)), _breaks(self.whole)) if self.whole[one[0]]]
        squares: list[Array] = []
        for one in stretches:
            if len(one) * STEP < 4 * SMOOTHING:
                continue
            radius = self.radius[:, one]
            around = SMOOTHING / (float(np.median(radius)) * 2 * np.pi / len(radius))
            smooth = gaussian_filter1d(radius, SMOOTHING / STEP, axis=1, mode="nearest")
            smooth = gaussian_filter(smooth, (around, 0), mode="wrap")
            inner = slice(round(SMOOTHING / STEP), -round(SMOOTHING / STEP))
            squares.append(((radius - smooth)[:, inner] ** 2).ravel())
        return float(np.sqrt(np.concatenate(squares).mean())) if squares else float("nan")

    def _clipped(self) -> Array:
        return np.minimum(self.radius, _WIDEST * np.median(self.radius, axis=0))


def cut_sections(phantom: Phantom, name: str) -> Sections:
    """Cuts a branch across at even steps, from its ostium on."""
    tree, branch = phantom.tree, phantom.tree[name]
    first = tree.ostium_arc(name)
    arc = np.arange(first, branch.length, STEP)
    line = smoothed(branch.point_at(arc), _CENTRELINE) if len(arc) > 3 else branch.point_at(arc)
    tangents = np.gradient(line, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    reach = 2.5 * float(branch.radius.max())
    radius = wall_radii(phantom.grid, line, tangents, reach)
    sound = (radius.min(axis=0) > 0) & (np.median(radius, axis=0) < reach)
    whole = sound & (radius.max(axis=0) < _WIDEST * np.median(radius, axis=0))
    if branch.parent is None:
        whole &= arc > _END
    else:  # the flare of the ostium belongs to both vessels
        whole &= arc > first + 2 * float(branch.radius_at(first))
    if branch.open_end:
        whole &= arc < branch.length - _END
    for child in tree:
        if child.parent == name:
            # a pouch may lie within its vessel's tube
            leaves = child.open_end or any(other.parent == child.name for other in tree)
            place = ostium_place(phantom, child.name) if leaves else child.parent_arc
            edge = float(child.radius_at(tree.ostium_arc(child.name)) if leaves else child.radius.max())
            whole &= np.abs(arc - place) > edge + _OSTIUM
    return Sections(arc, radius, sound, whole)


def wall_radii(grid: SignedDistanceGrid, points: Array, tangents: Array, reach: float) -> Array:
    """Distances (RAYS, n) m to where rays across a vessel first leave the lumen, `reach` (m) where they do not.

    Looks at the sign of the distance only, so that a coarse grid, whose distances in the middle of a vessel are not
    exact, gives the wall as well as a fine one.
    """
    first, second = across_frames(tangents)
    angle = np.arange(RAYS) * 2 * np.pi / RAYS
    directions = np.cos(angle)[:, None, None] * first + np.sin(angle)[:, None, None] * second
    before = np.broadcast_to(grid.sample(points), (RAYS, len(points)))
    radius = np.where(before > 0, reach, 0.0)
    open_ = before > 0
    for travelled in np.arange(_RAY_STEP, reach, _RAY_STEP):
        value = np.full(before.shape, -1.0)
        value[open_] = grid.sample((points + travelled * directions)[open_])
        left = open_ & (value <= 0)
        share = before[left] / (before[left] - value[left])
        radius[left] = travelled + (share - 1) * _RAY_STEP
        open_ = open_ & ~left
        before = value
        if not open_.any():
            break
    return radius


def ostium_place(phantom: Phantom, child: str) -> float:
    """Arc length (m) along its parent nearest to a branch's ostium."""
    tree = phantom.tree
    parent = tree[child].parent
    assert parent is not None
    return float(tree[parent].arc[np.argmin(np.linalg.norm(tree[parent].points - tree.ostium(child), axis=1))])


def _breaks(whole: NDArray[np.bool_]) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(whole.astype(int))) + 1
