"""Beads of a cube recognised as a lattice: which bead is which, up to the lattice's symmetries, and a first camera.

Three beads taken for a corner and its two neighbours give up to four poses; every window of the lattice around is
scored by the beads it explains, the best ones grow and are refined.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from guide3d.calibration.pinhole_fit import IntrinsicPrior, refine_camera
from guide3d.geometry.camera import Camera

logger = logging.getLogger(__name__)

_NEIGHBOURS = 26  # beads around a corner that its lattice neighbours are looked for among
_MOST_TRIPLES = 30_000
_PROMISING = 1500  # poses at least that are scored on the whole lattice
_GROWN = 60  # best hypotheses that are refined
_FIRST_TOLERANCE_PX = 7.0  # beside the corner; as much again for every lattice step away
_GATES_PX = (40.0, 25.0, 16.0, 10.0, 7.0, 5.0, 4.0, 4.0)
_LEAST_BEADS = 12


@dataclass(frozen=True, eq=False)
class CubeLattice:
    """The beads of a cube.

    points_mm: (n, 3) in the cube's frame
    sites: (n, 3) whole numbers, their place on the lattice, from 0
    symmetries: (g, n) each a renumbering by a rotation that maps the lattice onto itself: bead k goes where
        bead symmetries[i, k] was
    """

    points_mm: np.ndarray
    sites: np.ndarray
    pitch_mm: float
    symmetries: np.ndarray

    @classmethod
    def of(cls, points_mm: np.ndarray) -> CubeLattice:
        """The lattice of bead coordinates.

        Args:
            points_mm: (n, 3) mm; up to a twentieth of a pitch off a full cubic lattice.

        Raises:
            ValueError: The beads do not form a full lattice with one pitch.
        """
        points_mm = np.asarray(points_mm, float)
        if points_mm.ndim != 2 or points_mm.shape[1:] != (3,) or len(points_mm) < 8 or not np.isfinite(points_mm).all():
            raise ValueError(f"expected bead coordinates (n, 3) of a lattice, found shape {points_mm.shape}")
        nearest = cKDTree(points_mm).query(points_mm, k=2)[0][:, 1]
        pitch = float(np.median(nearest))
        if pitch <= 0:
            raise ValueError("expected beads on a lattice, found some at the same place")
        sites = np.rint((points_mm - points_mm.min(axis=0)) / pitch).astype(int)
        off = np.abs(points_mm - points_mm.min(axis=0) - sites * pitch).max()
        size = sites.max(axis=0) + 1
        if off > 0.05 * pitch or len(np.unique(sites, axis=0)) != len(sites) or np.prod(size) != len(sites):
            raise ValueError(
                f"expected beads on a full lattice of one pitch, found {len(sites)} beads on "
                f"{' x '.join(map(str, size))} sites, up to {off:.1f} mm off a pitch of {pitch:.1f} mm"
            )
        number = {tuple(site): k for k, site in enumerate(sites.tolist())}
        doubled = 2 * sites - (size - 1)  # centred
        symmetries = []
        for order in itertools.permutations(range(3)):
            for signs in itertools.product((1, -1), repeat=3):
                R = np.zeros((3, 3), int)
                R[range(3), order] = signs
                moved = doubled @ R.T
                if round(np.linalg.det(R)) == 1 and (np.abs(moved).max(axis=0) == np.abs(doubled).max(axis=0)).all():
                    symmetries.append([number[tuple(site)] for site in ((moved + size - 1) // 2).tolist()])
        return cls(points_mm, sites, pitch, np.array(symmetries))


@dataclass(frozen=True, eq=False)
class LatticeFit:
    """A lattice recognised in one image.

    numbers: (m,) bead of each found disc, -1 for clutter; right up to a symmetry and a shift by hidden layers
    camera: in the cube's frame of that numbering
    missing: beads that should be in the image and were not found
    """

    numbers: np.ndarray
    camera: Camera
    missing: int


def recognise_lattice(
    lattice: CubeLattice,
    pixels: np.ndarray,
    width: int,
    height: int,
    in_field: np.ndarray | None = None,
) -> LatticeFit:
    """Tell which disc is which bead, up to symmetry.

    Args:
        pixels: (m, 2) undistorted px of discs, clutter allowed.
        width, height: Of the image, px.
        in_field: (h, w) bool in undistorted pixels, where a bead could be seen; None for the whole image.

    Raises:
        ValueError: Fewer than twelve discs, or no lattice that explains twelve of them.
    """
    pixels = np.asarray(pixels, float).reshape(-1, 2)
    if len(pixels) < _LEAST_BEADS:
        raise ValueError(f"expected {_LEAST_BEADS} beads of the cube or more in the image, found {len(pixels)}")
    # the focal length may be a quarter off
    prior = IntrinsicPrior(4.7 * max(width, height), centre_sd=0.2 * max(width, height))
    K = np.array([[prior.focal_px, 0, (width - 1) / 2], [0, prior.focal_px, (height - 1) / 2], [0, 0, 1.0]])
    field = np.ones((height, width), bool) if in_field is None else np.asarray(in_field, bool)
    search = _Search(lattice, pixels, K, field)
    best: tuple[float, LatticeFit] | None = None
    enough = max(_LEAST_BEADS, 0.9 * len(pixels))
    for hypotheses in search.rounds(np.random.default_rng(0)):
        for R, t, window in hypotheses:
            grown = _grown(lattice, pixels, Camera(K, R, t, width, height), window, field, prior)
            if grown is not None and (best is None or grown[0] > best[0]):
                best = grown
                if (grown[1].numbers >= 0).sum() >= enough and grown[1].missing <= 2:
                    break  # nothing better is to come
        if best is not None and (best[1].numbers >= 0).sum() >= enough and best[1].missing <= 2:
            break
    if best is None or (best[1].numbers >= 0).sum() < _LEAST_BEADS:
        recognised = 0 if best is None else int((best[1].numbers >= 0).sum())
        raise ValueError(
            f"expected a lattice that explains {_LEAST_BEADS} of the {len(pixels)} discs or more, "
            f"found one that explains {recognised}"
        )
    logger.debug(
        "%d of %d discs on the lattice, %d missing", (best[1].numbers >= 0).sum(), len(pixels), best[1].missing
    )
    return best[1]


class _Search:
    """Poses from triples of discs, scored on the lattice around their corner."""

    def __init__(self, lattice: CubeLattice, pixels: np.ndarray, K: np.ndarray, field: np.ndarray) -> None:
        self.lattice, self.pixels, self.K, self.field = lattice, pixels, K, field
        self.size = lattice.sites.max(axis=0) + 1
        reach = int(self.size.max()) - 1
        steps = np.arange(-reach, reach + 1)
        self.around = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        self.span = 2 * reach + 1
        # distance to the nearest disc on a grid of 2 px, which also covers a margin outside the image
        self.margin = 64
        h, w = field.shape
        y, x = np.mgrid[-self.margin : h + self.margin : 2, -self.margin : w + self.margin : 2]
        self.nearest = cKDTree(pixels).query(np.stack([x, y], axis=-1))[0]
        self.lit = np.pad(field, self.margin)[::2, ::2]

    def rounds(self, rng: np.random.Generator) -> Iterator[list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
        """The best (R, t, lowest site of the window from the corner), best first: of some triples, then of the rest."""
        corner, a, b = self._triples(rng)
        order = rng.permutation(len(corner))
        for part in np.split(order, [len(order) // 5]):
            poses = _right_corners(
                self._rays(corner[part]), self._rays(a[part]), self._rays(b[part]), self.lattice.pitch_mm
            )
            if not len(poses):
                continue
            poses = self._promising(poses)
            scored = [self._scored(poses[start : start + 2000]) for start in range(0, len(poses), 2000)]
            score = np.concatenate([own for own, _ in scored])
            window = np.concatenate([own for _, own in scored])
            best = np.argsort(-score, kind="stable")[:_GROWN]
            yield [(poses[k, :, :3], poses[k, :, 3], window[k]) for k in best]

    def _triples(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = min(_NEIGHBOURS + 1, len(self.pixels))
        around = cKDTree(self.pixels).query(self.pixels, k=count)[1][:, 1:]
        first, second = np.triu_indices(count - 1, 1)
        corner = np.repeat(np.arange(len(self.pixels)), len(first))
        a, b = around[:, first].ravel(), around[:, second].ravel()
        if len(corner) > _MOST_TRIPLES:
            drawn = rng.choice(len(corner), _MOST_TRIPLES, replace=False)
            corner, a, b = corner[drawn], a[drawn], b[drawn]
        return corner, a, b

    def _rays(self, which: np.ndarray) -> np.ndarray:
        rays = np.column_stack([self.pixels, np.ones(len(self.pixels))]) @ np.linalg.inv(self.K).T
        return (rays / np.linalg.norm(rays, axis=1, keepdims=True))[which]

    def _promising(self, poses: np.ndarray) -> np.ndarray:
        """The poses that explain most discs right around their corner."""
        beside = np.flatnonzero(np.abs(self.around).max(axis=1) <= 1)
        count = max(_PROMISING, len(poses) // 6)
        if len(poses) <= count:
            return poses
        worth = np.concatenate(
            [self._worth(poses[start : start + 4000], beside) for start in range(0, len(poses), 4000)]
        )
        # a corner of the cube has beads on one side only: the octant that fits best counts
        steps = self.around[beside]
        octants = [(steps * signs >= 0).all(axis=1) for signs in itertools.product((1, -1), repeat=3)]
        score = np.max([worth[:, octant].sum(axis=1) for octant in octants], axis=0)
        return poses[np.argsort(-score, kind="stable")[:count]]

    def _scored(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The best window's score (n,) and lowest site (n, 3) of each pose."""
        worth = self._worth(poses, np.arange(len(self.around)))
        sums = worth.reshape(-1, self.span, self.span, self.span)
        for axis in range(3):
            total = np.cumsum(sums, axis=axis + 1)
            total = np.concatenate([np.zeros_like(total.take([0], axis + 1)), total], axis=axis + 1)
            n = int(self.size[axis])
            low, high = np.arange(self.span - n + 1), np.arange(n, self.span + 1)
            sums = total.take(high, axis + 1) - total.take(low, axis + 1)
        flat = sums.reshape(len(poses), -1)
        best = flat.argmax(axis=1)
        lowest = np.stack(np.unravel_index(best, sums.shape[1:]), axis=1) - (self.span // 2)
        return flat[np.arange(len(poses)), best], lowest

    def _worth(self, poses: np.ndarray, which: np.ndarray) -> np.ndarray:
        """What the lattice sites `which` (k,) speak for each pose: (n, k)."""
        place = self.around[which] * self.lattice.pitch_mm
        seen = np.einsum("nij,kj->nki", poses[:, :, :3], place) + poses[:, None, :, 3]
        seen = seen @ self.K.T
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = seen[..., :2] / seen[..., 2:]
        cell = np.nan_to_num((xy + self.margin) / 2, nan=-1, posinf=-1, neginf=-1)
        column, row = np.rint(np.clip(cell, -1, 1e6)).astype(int).transpose(2, 0, 1)
        inside = (row >= 0) & (row < self.nearest.shape[0]) & (column >= 0) & (column < self.nearest.shape[1])
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        tolerance = _FIRST_TOLERANCE_PX * (1 + np.abs(self.around[which]).max(axis=1))
        distance = np.where(inside, self.nearest[row, column], np.inf)
        # a hit is worth what chance would not give it: the wider the tolerance, the less
        return np.where(distance < tolerance, 1.0 - 0.5 * distance / tolerance, -0.3 * (inside & self.lit[row, column]))


def _right_corners(o: np.ndarray, a: np.ndarray, b: np.ndarray, side_mm: float) -> np.ndarray:
    """Poses (m, 3, 4) of corners with two perpendicular sides of one length, seen along unit rays (n, 3)."""
    ca, cb, cab = (o * a).sum(axis=1), (o * b).sum(axis=1), (a * b).sum(axis=1)
    # with depths in units of the corner's: v = (u ca - 1) / (u cab - cb) for the right angle, u² - 2 u ca = v² - 2 v cb
    # for the equal sides; together a quartic in u
    N, D = np.stack([-np.ones_like(ca), ca]), np.stack([-cb, cab])  # of increasing powers
    DD = np.stack([D[0] ** 2, 2 * D[0] * D[1], D[1] ** 2])
    NN = np.stack([N[0] ** 2, 2 * N[0] * N[1], N[1] ** 2])
    ND = np.stack([N[0] * D[0], N[0] * D[1] + N[1] * D[0], N[1] * D[1]])
    quartic = np.zeros((5, len(ca)))
    quartic[2:] += DD
    quartic[1:4] -= 2 * ca * DD
    quartic[:3] -= NN - 2 * cb * ND
    leading = np.where(np.abs(quartic[4]) < 1e-14, 1e-14, quartic[4])
    companion = np.zeros((len(ca), 4, 4))
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    companion[:, :, 3] = -(quartic[:4] / leading).T
    roots = np.linalg.eigvals(companion)
    which, number = np.nonzero((np.abs(roots.imag) < 1e-3 * np.abs(roots.real)) & (np.abs(roots.real - 1) < 0.3))
    u = roots.real[which, number]
    for _ in range(3):  # polish: the quartic is nearly degenerate for a distant source
        q = quartic[:, which]
        value = (((q[4] * u + q[3]) * u + q[2]) * u + q[1]) * u + q[0]
        slope = ((4 * q[4] * u + 3 * q[3]) * u + 2 * q[2]) * u + q[1]
        u = u - np.clip(value / np.where(np.abs(slope) < 1e-18, 1e-18, slope), -0.01, 0.01)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = (u * ca[which] - 1) / (u * cab[which] - cb[which])
        depth = side_mm / np.sqrt(1 + u**2 - 2 * u * ca[which])
    good = np.isfinite(depth) & (np.abs(v - 1) < 0.3) & (u > 0)
    which, u, v, depth = which[good], u[good], v[good], depth[good]
    corner = depth[:, None] * o[which]
    x = (depth * u)[:, None] * a[which] - corner
    y = (depth * v)[:, None] * b[which] - corner
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y -= (x * y).sum(axis=1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y), corner], axis=2)


def _grown(
    lattice: CubeLattice,
    pixels: np.ndarray,
    start: Camera,
    window: np.ndarray,
    field: np.ndarray,
    prior: IntrinsicPrior,
) -> tuple[float, LatticeFit] | None:
    """Assign, refine, and again with narrower gates; returns score and fit, or None when it dies out."""
    ideal = lattice.sites * lattice.pitch_mm
    # the corner is the origin of the start's frame: move it to the window's lowest site
    t = start.t_mm + start.R @ (window * lattice.pitch_mm)
    camera = Camera(start.K, start.R, t, start.width, start.height)
    number, disc, points = np.empty(0, int), np.empty(0, int), ideal
    for gate in _GATES_PX:
        if (camera.depth_mm(points) <= 0).any():
            return None
        number, disc = _assigned(camera.project(points), pixels, gate)
        if len(number) < 6:
            return None
        # coarse gates take in strangers: limit their pull
        camera = refine_camera(camera, points[number], pixels[disc], prior, 1.0, robust_px=gate / 3, rounds=8)
        points = lattice.points_mm - lattice.points_mm.min(axis=0) if gate < 6 else ideal
    off = camera.project(points)
    number, disc = _assigned(off, pixels, _GATES_PX[-1])
    if len(number) < 6:
        return None
    missing = np.setdiff1d(np.arange(len(points)), number)
    x, y = np.rint(off[missing]).astype(int).T
    inside = (x >= 4) & (y >= 4) & (x < field.shape[1] - 4) & (y < field.shape[0] - 4)
    lost = int(field[y[inside], x[inside]].sum())
    residual = np.linalg.norm(off[number] - pixels[disc], axis=1)
    numbers = np.full(len(pixels), -1)
    numbers[disc] = number
    shift = camera.R @ lattice.points_mm.min(axis=0)
    camera = Camera(camera.K, camera.R, camera.t_mm - shift, camera.width, camera.height)
    # residuals and the prior's pull tell a true fit from one that bends to reach as many
    pull = float((prior.rows(camera.K, camera.width, camera.height)[0] ** 2).sum())
    score = len(number) - 0.3 * lost - 0.1 * residual.mean() * len(number) / _GATES_PX[-1] - 0.3 * pull
    return score, LatticeFit(numbers, camera, lost)


def _assigned(places: np.ndarray, pixels: np.ndarray, gate: float) -> tuple[np.ndarray, np.ndarray]:
    """Which place goes with which disc, one to one, within a gate: two index arrays (k,)."""
    distance = np.linalg.norm(places[:, None] - pixels, axis=2)
    cost = np.minimum(distance, gate)
    rows, columns = linear_sum_assignment(cost)
    near = distance[rows, columns] < gate
    return rows[near], columns[near]
