"""A hexagonal lattice seen in an image: indices for its points, places for its indices, what is missing or irregular.

Indices are axial: q along one row, r along the row at 60 degrees to it.
"""

from __future__ import annotations

import heapq

import numpy as np
from scipy.spatial import cKDTree

from guide3d.geometry.displacement_field import quadratic_terms

# the six neighbours of a lattice site in axial coordinates, in the order of their angle
NEIGHBOURS = np.array([[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]])
_TOLERANCE = 0.28  # of a pitch, between where growth expects a point and where it is


def lattice_points(indices: np.ndarray) -> np.ndarray:
    """Places (..., 2) of axial indices (..., 2) on a lattice of pitch one: q along x, r at 60 degrees towards y."""
    indices = np.asarray(indices, float)
    return np.stack([indices[..., 0] + 0.5 * indices[..., 1], np.sqrt(0.75) * indices[..., 1]], axis=-1)


def grow_lattice(centres: np.ndarray, pitch: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Index points outwards from the middle of the image, the surest first.

    Args:
        centres: (m, 2) px, clutter allowed.
        pitch: Rough distance of neighbours, px.
        shape: (h, w) of the image.

    Returns:
        Which points are on the lattice (n,) and their axial indices (n, 2), sorted by row; (0, 0) is near the middle.

    Raises:
        ValueError: Nothing in the middle looks like a hexagonal lattice.
    """
    tree = cKDTree(centres)
    middle = np.array([shape[1] - 1, shape[0] - 1]) / 2
    seed, basis = _seed(centres, tree, middle, pitch)
    around = NEIGHBOURS.tolist()
    site_of: dict[int, tuple[int, int]] = {seed: (0, 0)}
    hole_at: dict[tuple[int, int], int] = {(0, 0): seed}
    steps = {seed: basis}  # the local lattice vectors (2, 2) at each indexed hole
    queue: list[tuple[float, int, int, int]] = []

    def offer(hole: int) -> None:
        q, r = site_of[hole]
        distances, others = tree.query(centres[hole] + NEIGHBOURS @ steps[hole])
        for number, (distance, other) in enumerate(zip(distances.tolist(), others.tolist(), strict=True)):
            site = q + around[number][0], r + around[number][1]
            if site not in hole_at and distance < _TOLERANCE * pitch and other not in site_of:
                heapq.heappush(queue, (distance / pitch, hole, number, other))

    offer(seed)
    while queue:
        _, hole, number, other = heapq.heappop(queue)
        q, r = site_of[hole]
        site = q + around[number][0], r + around[number][1]
        if site in hole_at or other in site_of:
            continue
        site_of[other], hole_at[site] = site, other
        # lattice vectors at the new hole: those seen between it and its indexed neighbours, else its parent's
        seen = [(nb, hole_at[at]) for nb in around if (at := (site[0] + nb[0], site[1] + nb[1])) in hole_at]
        A = np.array([nb for nb, _ in seen], float)
        B = centres[[index for _, index in seen]] - centres[other]
        steps[other] = np.linalg.solve(A.T @ A + np.eye(2), A.T @ B + steps[hole])  # its parent's as a prior
        offer(other)
    chosen = np.array(sorted(site_of, key=lambda hole: site_of[hole][::-1]))
    return chosen, np.array([site_of[hole] for hole in chosen])


def _seed(centres: np.ndarray, tree: cKDTree, middle: np.ndarray, pitch: float) -> tuple[int, np.ndarray]:
    """The hole near the middle whose six neighbours are the most regular, and the two lattice vectors (2, 2) there."""
    best = (np.inf, -1, np.eye(2))
    for hole in tree.query(middle, k=min(60, len(centres)))[1]:
        around = [other for other in tree.query_ball_point(centres[hole], 1.35 * pitch) if other != hole]
        if len(around) != 6:
            continue
        arms = centres[around] - centres[hole]
        arms = arms[np.argsort(np.arctan2(arms[:, 1], arms[:, 0]))]
        # arms go round clockwise on the screen; start with the one closest to +x
        arms = np.roll(arms, -int(np.argmax(arms[:, 0] / np.linalg.norm(arms, axis=1))), axis=0)
        basis = np.linalg.lstsq(NEIGHBOURS.astype(float), arms, rcond=None)[0]
        off = np.abs(NEIGHBOURS @ basis - arms).max() / pitch
        if off < best[0]:
            best = (off, int(hole), basis)
    if best[1] < 0 or best[0] > 0.2:
        raise ValueError(
            "expected an X-ray of a perforated sheet, found no hole with six regular neighbours in the middle"
        )
    return best[1], best[2]


def _around(indices: np.ndarray, count: int) -> np.ndarray:
    """The `count` nearest other holes on the lattice (n, count) of each hole."""
    places = lattice_points(indices)
    return cKDTree(places).query(places, k=count + 1)[1][:, 1:]


def regular(centres: np.ndarray, indices: np.ndarray, tolerance_px: float) -> np.ndarray:
    """Which holes (n,) lie within a tolerance of the quadratic through their 18 neighbours, the worst dropped first."""
    fits = np.ones(len(centres), bool)
    for _ in range(8):
        which = np.flatnonzero(fits)
        around = which[_around(indices[which], 18)]
        away = lattice_points(indices[around] - indices[which][:, None])
        off = np.linalg.norm(predicted(away, centres[around]) - centres[which], axis=1)
        # a bad hole spoils its neighbours' predictions, too: drop only those worse than all around them
        worst = np.zeros(len(centres))
        worst[which] = off
        bad = (off > tolerance_px) & (off >= worst[around].max(axis=1))
        if not bad.any():
            break
        fits[which[bad]] = False
    return fits


def predicted(away: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Where the quadratics through pixels `seen` (m, k, 2), `away` (m, k, 2) lattice steps off, put sites (m, 2)."""
    A = quadratic_terms(away)
    # a trace of ridge holds the few holes whose neighbours all lie on one side
    normal = A.transpose(0, 2, 1) @ A + 1e-6 * np.eye(6)
    return np.linalg.solve(normal, A.transpose(0, 2, 1) @ seen)[:, 0]


def missed_sites(centres: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lattice sites beside at least two holes where none was found (m, 2), and where they are expected (m, 2) px."""
    have = set(map(tuple, indices.tolist()))
    beside: dict[tuple[int, int], int] = {}
    sides = NEIGHBOURS.tolist()
    for q, r in have:
        for dq, dr in sides:
            if (q + dq, r + dr) not in have:
                beside[q + dq, r + dr] = beside.get((q + dq, r + dr), 0) + 1
    missed = np.array(sorted(site for site, count in beside.items() if count >= 2)).reshape(-1, 2)
    if not len(missed):
        return missed, np.empty((0, 2))
    around = cKDTree(lattice_points(indices)).query(lattice_points(missed), k=18)[1]
    away = lattice_points(indices[around] - missed[:, None])
    return missed, predicted(away, centres[around])


def local_lattice(centres: np.ndarray, indices: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """The matrix (m, 2, 2) that takes lattice steps of pitch one to pixel steps around each of `sites` (m, 2)."""
    if not len(sites):
        return np.empty((0, 2, 2))
    around = cKDTree(lattice_points(indices)).query(lattice_points(sites), k=7)[1]
    A = lattice_points(indices[around])
    A = A - A.mean(axis=1, keepdims=True)
    B = centres[around] - centres[around].mean(axis=1, keepdims=True)
    normal = A.transpose(0, 2, 1) @ A
    return np.linalg.solve(normal, A.transpose(0, 2, 1) @ B).transpose(0, 2, 1)
