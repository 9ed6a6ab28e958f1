"""Vessels that form a ring: the lumen stays open around it, and each of its vessels ends where they meet."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from cathsim.anatomy import Phantom, import_mesh
from cathsim.anatomy.mesh.arches.arch_naming import name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel

SPACING = 1.5e-3  # m
RADIUS = 3e-3  # m, of the vessel that closes the ring


@pytest.fixture(scope="module")
def link(phantom: Phantom) -> np.ndarray:
    """Middle (n, 3) m of a vessel from the LCCA's end over the head to the RCCA's."""
    (first, up), (last, _) = ((b.points[-6], b.points[-1] - b.points[-6]) for b in map(phantom.tree.__getitem__, PAIR))
    angles = np.linspace(0, np.pi, 80)[:, None]
    across = (last - first) / 2
    return (first + last) / 2 - np.cos(angles) * across + np.sin(angles) * up / np.linalg.norm(up) * 0.03


PAIR = ("lcca", "rcca")


@pytest.fixture(scope="module")
def ring(phantom: Phantom, link: np.ndarray, cache: Path) -> Phantom:
    low, high = phantom.grid.bounds[0] - 3e-3, np.maximum(phantom.grid.bounds[1], link.max(axis=0) + RADIUS) + 3e-3
    axes = [np.arange(a, b, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    lumen = np.maximum(phantom.grid.sample(points), RADIUS - cKDTree(link).query(points)[0])
    corners, faces, *_ = marching_cubes(lumen, 0.0)
    path = cache / "ring.stl"
    trimesh.Trimesh((low + corners * SPACING) * 1e3, faces[:, ::-1]).export(path)
    return import_mesh(path, unit="mm", resolution=SPACING, cache_dir=cache)


def _in_import(points: np.ndarray, ring: Phantom) -> np.ndarray:
    report = ring.imported
    return points @ np.array(report.rotation).T + np.array(report.offset)


def test_a_ring_is_told_and_nothing_closes_it(ring: Phantom, link: np.ndarray) -> None:
    assert any("a ring" in note for note in ring.imported.notes), ring.imported.notes
    assert {"bca", "lcca", "lsa", "rcca", "rsa"} <= set(ring.tree.names)
    assert ring.grid.sample(_in_import(link, ring)).min() > RADIUS - SPACING
    ends = {name for name in ring.targets if name.endswith("_end")}
    assert ends == {"lsa_end", "rsa_end"}, "where vessels of a ring meet there is no open end"


def test_centrelines_meet_in_the_ring_and_ways_go_the_shorter_side(ring: Phantom, link: np.ndarray) -> None:
    tips = [ring.tree[name].points[-1] for name in PAIR]
    assert np.linalg.norm(tips[0] - tips[1]) < 0.02
    top = tuple(_in_import(link[40], ring).tolist())
    lengths = [ring.geodesic_distance(_in_import(link[i], ring), top) for i in (0, 79)]
    chords = [np.linalg.norm(np.diff(part, axis=0), axis=1).sum() for part in (link[:41], link[40:])]
    np.testing.assert_allclose(lengths, chords, rtol=0.1)  # from either side; a wall would make one of them a detour


def _vessel(*corners: tuple[float, float, float], radius: float, start: float = 0.0) -> RoughVessel:
    points = np.concatenate([np.linspace(a, b, 60) for a, b in itertools.pairwise(corners)])
    return RoughVessel(points, np.full(len(points), radius), 0, [], start)


def test_a_subclavian_artery_goes_to_the_arm_and_the_vertebral_one_to_the_head() -> None:
    aorta = _vessel((0.05, 0.02, -0.15), (0.05, 0.02, 0.0), (-0.02, -0.02, 0.0), (-0.02, -0.02, -0.05), radius=0.012)
    right = _vessel((-0.02, -0.02, 0.0), (-0.04, -0.02, 0.06), radius=0.005, start=0.23)
    middle = _vessel((0.0, 0.0, 0.0), (0.0, 0.0, 0.15), radius=0.004, start=0.2)
    left = _vessel((0.04, 0.01, 0.0), (0.06, 0.01, 0.03), (0.06, 0.01, 0.2), radius=0.004, start=0.16)
    arm = _vessel((0.06, 0.01, 0.03), (0.15, 0.01, 0.02), radius=0.003, start=0.036)
    left.children = [arm]
    aorta.children = [left, middle, right]
    names, _ = name_vessels(aorta, sides_known=True)
    by_name = {names[id(vessel)]: vessel for vessel in aorta.every}
    assert by_name["lsa"].points[-1].tolist() == [0.15, 0.01, 0.02]
    assert by_name["vertebral_left"].points[-1].tolist() == [0.06, 0.01, 0.2]
