"""Which of the cube's 24 attitudes and which layers: decided by its marked beads and by detectors that stand still.

A lattice looks the same after a rotation, and, where a layer lies outside the image, after a shift by one layer.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from guide3d.calibration.lattice_camera import CubeLattice, LatticeFit
from guide3d.calibration.wire_marks import WireMark
from guide3d.geometry.camera import Camera

logger = logging.getLogger(__name__)

_MARK_REACH = 0.1  # of the lattice's pitch as seen: how far a wire lies from its bead, one standard deviation
_ABSENT = -0.4  # where a mark should be seen and none of its kind is
_MEETING_MM = 6.0  # by which the rays through one mark's centres miss each other
_RIG_DEG, _RIG_MM = 1.5, 25.0  # by which single poses' relative camera places differ


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to number the beads of an image.

    numbers: (m,) bead of each disc, -1 for clutter
    """

    numbers: np.ndarray
    camera: Camera


def candidates(lattice: CubeLattice, fit: LatticeFit, field: np.ndarray) -> list[Candidate]:
    """Every numbering that explains the beads of one image equally well.

    Args:
        field: (h, w) bool in undistorted pixels, where beads can be seen.

    Returns:
        All rotations of all shifts that put no more unseen beads into the field than `fit` does, `fit` itself first.
    """
    on = fit.numbers >= 0
    sites, size = lattice.sites[fit.numbers[on]], lattice.sites.max(axis=0) + 1
    number = {tuple(site): k for k, site in enumerate(lattice.sites.tolist())}
    shifts = sorted(itertools.product(*(range(-int(n) + 1, int(n)) for n in size)), key=lambda s: (np.abs(s).sum(), s))
    centre = (lattice.sites.max(axis=0) / 2 - lattice.sites) * lattice.pitch_mm
    candidate_poses = []
    for shift in shifts:
        moved = sites + shift
        if (moved < 0).any() or (moved >= size).any():
            continue
        numbers = np.full(len(on), -1)
        numbers[on] = [number[tuple(site)] for site in moved.tolist()]
        t = fit.camera.t_mm - fit.camera.R @ (np.array(shift) * lattice.pitch_mm)
        camera = Camera(fit.camera.K, fit.camera.R, t, fit.camera.width, fit.camera.height)
        unseen = np.setdiff1d(np.arange(len(lattice.sites)), numbers)
        if _in_field(camera.project(lattice.points_mm[unseen]), field).sum() > fit.missing + 1:
            continue
        for symmetry in lattice.symmetries:
            # the rotation that takes every bead's site to its new bead's site, about the middle of the lattice
            U, _, V = np.linalg.svd(centre.T @ centre[symmetry])
            R = camera.R @ U @ V
            middle = lattice.points_mm.mean(axis=0)
            turned = Camera(camera.K, R, camera.t_mm + camera.R @ middle - R @ middle, camera.width, camera.height)
            renumbered = np.where(numbers >= 0, symmetry[numbers], -1)
            candidate_poses.append(Candidate(renumbered, turned))
    return candidate_poses


def decide(
    lattice: CubeLattice,
    poses: Sequence[Mapping[str, tuple[list[Candidate], list[WireMark], np.ndarray]]],
    marked: Mapping[str, int],
) -> tuple[list[dict[str, int]], list[bool]]:
    """Choose one candidate for every image of every pose.

    Args:
        poses: For each pose, by detector: its candidates, marks seen and field (h, w), both in undistorted pixels.
        marked: Bead number (from 0) of each kind of mark; other kinds are ignored.

    Returns:
        For each pose the chosen candidate by detector, and whether the marks decided the cube's attitude.
    """
    evidence = [
        {
            detector: np.array([_mark_score(lattice, c.camera, marks, field, marked) for c in options])
            for detector, (options, marks, field) in pose.items()
        }
        for pose in poses
    ]
    rigs = _rigs(poses, evidence, marked)
    chosen, certain = [], []
    for pose, scores in zip(poses, evidence, strict=True):
        first = next(iter(pose))
        total = scores[first].copy()
        partner: dict[str, np.ndarray] = {}
        for other in pose:
            if other == first:
                continue
            pair = _pair_scores(pose[first], pose[other], scores[other], marked)
            if (first, other) in rigs:
                pair += _rig_scores(pose[first][0], pose[other][0], rigs[first, other])
            partner[other] = pair.argmax(axis=1)
            total += pair.max(axis=1)
        best = int(total.argmax())
        chosen.append({first: best, **{other: int(index[best]) for other, index in partner.items()}})
        rivals = np.sort(total)[::-1]
        certain.append(bool(len(rivals) < 2 or rivals[0] - rivals[1] > 0.2))
        logger.debug("cube attitude: score %.2f, next %.2f", rivals[0], rivals[1] if len(rivals) > 1 else np.nan)
    return chosen, certain


def _in_field(pixels: np.ndarray, field: np.ndarray, margin: int = 12) -> np.ndarray:
    x, y = np.rint(np.clip(pixels, -1e6, 1e6)).astype(int).T
    inside = (x >= margin) & (y >= margin) & (x < field.shape[1] - margin) & (y < field.shape[0] - margin)
    return inside & field[np.clip(y, 0, field.shape[0] - 1), np.clip(x, 0, field.shape[1] - 1)]


def _mark_score(
    lattice: CubeLattice, camera: Camera, marks: list[WireMark], field: np.ndarray, marked: Mapping[str, int]
) -> float:
    """How well the marks seen lie beside the beads that should bear them."""
    score = 0.0
    for kind in ("single", "double", "circle"):
        if kind not in marked:
            continue
        place = camera.project(lattice.points_mm[marked[kind]])
        if not _in_field(place[None], field, margin=40)[0]:
            continue
        scale = camera.K[0, 0] / camera.depth_mm(lattice.points_mm[marked[kind]]) * lattice.pitch_mm * _MARK_REACH
        own = [mark for mark in marks if mark.kind == kind]
        best = max((np.exp(-0.5 * (_distance(place, mark) / scale) ** 2) for mark in own), default=0.0)
        score += best if best > 0.05 else _ABSENT
    return float(score)


def _distance(place: np.ndarray, mark: WireMark) -> float:
    """Of a bead to its wire: a straight one may lie beside it, a pair or a ring lies around it."""
    if mark.kind == "single":
        return float(np.linalg.norm(mark.pixels - place, axis=1).min())
    return float(np.linalg.norm(mark.pixels.mean(axis=0) - place))


def _pair_scores(
    first: tuple[list[Candidate], list[WireMark], np.ndarray],
    other: tuple[list[Candidate], list[WireMark], np.ndarray],
    other_scores: np.ndarray,
    marked: Mapping[str, int],
) -> np.ndarray:
    """Evidence (n, m) of pairs of candidates: the other's own marks, and marks of a kind that meet in space."""
    score = np.repeat(other_scores[None], len(first[0]), axis=0)
    for kind in marked:
        a = [mark for mark in first[1] if mark.kind == kind]
        b = [mark for mark in other[1] if mark.kind == kind]
        if len(a) != 1 or len(b) != 1:
            continue
        rays_a = [(c.camera.centre_mm, c.camera.rays(a[0].pixels.mean(axis=0))) for c in first[0]]
        rays_b = [(c.camera.centre_mm, c.camera.rays(b[0].pixels.mean(axis=0))) for c in other[0]]
        for i, (p, u) in enumerate(rays_a):
            for j, (q, v) in enumerate(rays_b):
                across = np.cross(u, v)
                gap = abs((q - p) @ across) / max(float(np.linalg.norm(across)), 1e-9)
                score[i, j] += 0.5 * np.exp(-0.5 * (gap / _MEETING_MM) ** 2)
    return score


def _relative(first: Sequence[Candidate], other: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, m, 3, 3) and shifts (n, m, 3) mm from the first detector's frame to the other's."""
    Ra, ta = np.array([c.camera.R for c in first]), np.array([c.camera.t_mm for c in first])
    Rb, tb = np.array([c.camera.R for c in other]), np.array([c.camera.t_mm for c in other])
    R = np.einsum("mij,nkj->nmik", Rb, Ra)
    return R, tb[None] - np.einsum("nmij,nj->nmi", R, ta)


def _rigs(
    poses: Sequence[Mapping[str, tuple[list[Candidate], list[WireMark], np.ndarray]]],
    evidence: list[dict[str, np.ndarray]],
    marked: Mapping[str, int],
) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    """For pairs of detectors seen together in several poses: the relative place that recurs in most of them."""
    rigs = {}
    pairs = {(next(iter(pose)), other) for pose in poses for other in list(pose)[1:]}
    for pair in sorted(pairs):
        seen = [
            (pose, scores) for pose, scores in zip(poses, evidence, strict=True) if pair[0] in pose and pair[1] in pose
        ]
        if len(seen) < 2:
            continue
        relatives = []
        for pose, scores in seen:
            R, t = _relative(pose[pair[0]][0], pose[pair[1]][0])
            own = scores[pair[0]][:, None] + _pair_scores(pose[pair[0]], pose[pair[1]], scores[pair[1]], marked)
            relatives.append((R.reshape(-1, 3, 3), t.reshape(-1, 3), own.ravel()))
        best = (-np.inf, np.eye(3), np.zeros(3))
        for R, t, _ in relatives:
            # rotations of the cube change nothing between the detectors: one of each kind is enough
            _, distinct = np.unique(
                np.round(np.column_stack([R.reshape(-1, 9), t / 100]), 2), axis=0, return_index=True
            )
            for k in distinct:
                support = sum(float((o + 4 * _closeness(R[k], t[k], S, s)).max()) for S, s, o in relatives)
                if support > best[0]:
                    best = (support, R[k], t[k])
        rigs[pair] = best[1], best[2]
    return rigs


def _closeness(R: np.ndarray, t: np.ndarray, rotations: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """One where relative places (n, 3, 3), (n, 3) equal R, t; zero where they are unlike."""
    turn = np.degrees(np.arccos(np.clip((np.einsum("nij,ij->n", rotations, R) - 1) / 2, -1, 1)))
    return np.exp(-0.5 * (turn / _RIG_DEG) ** 2 - 0.5 * (np.linalg.norm(shifts - t, axis=1) / _RIG_MM) ** 2)


def _rig_scores(
    first: Sequence[Candidate], other: Sequence[Candidate], rig: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    R, t = _relative(first, other)
    shape = R.shape[:2]
    return 4 * _closeness(rig[0], rig[1], R.reshape(-1, 3, 3), t.reshape(-1, 3)).reshape(shape)
