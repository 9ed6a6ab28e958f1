"""The vessels of the task DualDeviceNav, from the groin to the circle of Willis: its surface and its centrelines.

The lumen is the published surface, with its rings. Branches follow the published centrelines where these lie in it;
their radii are measured in it, as the published ones are up to 5 mm larger.

Source: Karstensen et al. 2024, arXiv 2410.01956; the files are those of the repository lkarstensen/stEVE_bench, folder
data/dualdevicenav.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import resampled, smoothed
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.entry import Entry, locate_entries
from cathsim.anatomy.mesh.completion import propose_targets
from cathsim.anatomy.mesh.parts.vessel_parts import read_parts
from cathsim.anatomy.mesh.report import MeshRefusedError, Request, content_digest
from cathsim.anatomy.mesh.surface_import import SurfaceFacts, closed_lumen
from cathsim.anatomy.mesh.tree import STEP, measured_radii
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_tree import JOIN_TOLERANCE, Branch, VesselTree, nearest_on_branch
from cathsim.guarded_reading import UnreadableFileError, open_regular

ENDING = ".mrk.json"
_LARGEST = 20_000_000  # bytes of a file
_LPS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0)}

Array = NDArray[np.float64]

NAME = "dual_device_nav"
FOLDER = "CATHSIM_DUALDEVICENAV"  # environment variable with the folder of the files
SURFACE, CURVES = "vessel_architecture_collision.obj", "Centrelines_comb"
VERSION = 1  # raise it whenever the same files give another phantom
MM = 1e-3
# from the files' left, posterior and superior axes to the patient's, as the task turns them
ROTATION = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
ENTRY, DIRECTION = np.array([0.065, -0.005, 0.035]), np.array([-1.0, 0.0, 1.0]) / np.sqrt(2)  # m, left iliac artery
_SMOOTHING = 1e-3  # m
_LEAST = 4  # points of a branch
_LEAVES = 4  # points in a row outside the lumen: a centreline that leaves it

LCCA, RCCA, LVA, RVA = "- LCCA", "- RCCA", "- LVA", "- RVA"
TARGETS = (LCCA, LVA, RCCA, RVA)  # in the order in which the task draws from their points


class Curve(NamedTuple):
    """A centreline: points (n, 3) and radii (n,), in the file's unit, on axes to the left, posterior and superior."""

    points: Array
    radius: Array


def read_curve(path: Path) -> Curve:
    """Reads the curve of a markups file.

    Raises:
        UnreadableFileError: a ValueError of one sentence: there is no such file, or no curve with radii in it.
    """
    with open_regular(path, _LARGEST) as file:
        content = file.read()
    try:
        markup: dict[str, Any] = json.loads(content)["markups"][0]
        signs = _LPS[markup["coordinateSystem"]]
        points = np.array([one["position"] for one in markup["controlPoints"]], dtype=np.float64)
        radius = next(one["controlPointValues"] for one in markup["measurements"] if one["name"] == "Radius")
        curve = Curve(points * signs, np.array(radius, dtype=np.float64))
        sound = curve.points.shape == (len(curve.radius), 3) and len(curve.radius) > 1
    except (ValueError, KeyError, IndexError, TypeError, StopIteration, RecursionError):
        sound = False
    if not sound or not (np.isfinite(curve.points).all() and np.isfinite(curve.radius).all()):
        raise UnreadableFileError(f"{path.name} holds no curve with a radius at each point; write it again.")
    return curve


class Vessel(NamedTuple):
    """A vessel and the curves that it follows, one after the other; "-" before one that is followed backwards."""

    name: str
    parent: str | None
    curves: tuple[str, ...]


VESSELS = (
    Vessel("aorta", None, ("-(3)", "-(2)", "-(0)")),
    Vessel("iliac_right", "aorta", ("(5)", "(7)")),
    Vessel("lsa", "aorta", ("(18)", "(19)")),
    Vessel("vertebral_left", "lsa", (LVA,)),
    Vessel("lcca", "aorta", (LCCA,)),
    Vessel("bca", "aorta", ("(11)",)),
    Vessel("rcca", "bca", (RCCA,)),
    Vessel("rsa", "bca", (RVA, "(17)")),
    Vessel("vertebral_right", "rsa", (RVA,)),
    Vessel("basilar", "vertebral_left", ("(21)",)),
    Vessel("middle_cerebral_left", "lcca", ("(9)", "(10)")),
    Vessel("anterior_cerebral_left", "middle_cerebral_left", ("(23)",)),
    Vessel("middle_cerebral_right", "rcca", ("(13)",)),
    Vessel("anterior_cerebral_right", "rcca", ("(24)",)),
)


def published_folder(folder: str | Path | None = None) -> Path:
    """The folder of the published files.

    Args:
        folder: None: the one that the environment variable CATHSIM_DUALDEVICENAV names.

    Raises:
        ValueError: it is not given, or lacks a file; says where to get them and what to set.
    """
    location = folder or os.environ.get(FOLDER)
    path = Path(location).expanduser() if location else None
    if path is not None and is_published(path):
        return path
    where = "no folder is given" if path is None else f"{path} holds no {SURFACE} beside a folder {CURVES}"
    raise ValueError(
        f"the vessels of DualDeviceNav are not part of this package and {where}: get data/dualdevicenav of "
        f"https://github.com/lkarstensen/stEVE_bench (MIT license) and set {FOLDER} to that folder."
    )


def is_published(path: Path) -> bool:
    """Whether a folder holds the published files."""
    return (path / SURFACE).is_file() and (path / CURVES).is_dir()


def published_curves(folder: Path) -> dict[str, Curve]:
    """All published centrelines, m, in the patient's frame, by the last word of their files' names.

    Raises:
        ValueError: one that a vessel follows is missing.
    """
    curves = {}
    for path in sorted((folder / CURVES).glob("Centerline curve *" + ENDING)):
        points, radius = read_curve(path)
        curves[path.name[len("Centerline curve ") : -len(ENDING)]] = Curve(MM * points @ ROTATION.T, MM * radius)
    missing = {name.lstrip("-") if name[1] == "(" else name for vessel in VESSELS for name in vessel.curves} - {*curves}
    if missing:
        raise ValueError(f"{folder / CURVES} lacks the centrelines {', '.join(sorted(missing))}; get the folder again.")
    return curves


def published_digest(request: Request) -> str:
    """The hash of the phantom, of the files' content and the resolution."""
    files = [request.path / SURFACE, *sorted((request.path / CURVES).glob("*" + ENDING))]
    return content_digest({NAME: VERSION, "resolution": request.resolution}, files, in_folder=True)


def build_published_phantom(request: Request, digest: str) -> Phantom:
    """Builds the phantom of the published files without any cache.

    Raises:
        ValueError: a file is missing or is not the published one.
    """
    curves = published_curves(request.path)
    surface = read_parts(request.path / SURFACE)
    if len(surface.parts) != 1:
        raise MeshRefusedError(f"{SURFACE} has {len(surface.parts)} parts instead of one; get the file again.")
    facts = SurfaceFacts(SURFACE, "mm", scale=MM, faces=surface.faces)
    grid = closed_lumen(surface.parts[0].mesh.scaled(MM), facts, ROTATION, request.resolution)
    tree = build_tree(curves, grid)
    return Phantom(NAME, digest, None, tree, grid, propose_targets(tree)[0], locate_entries(tree))


def with_published_entry(phantom: Phantom) -> Phantom:
    """The phantom with the task's entry, which the cache does not hold: it knows no entry amid a vessel."""
    return replace(phantom, entries={**phantom.entries, "descending": Entry("descending", ENTRY, DIRECTION, amid=True)})


def target_points(phantom: Phantom) -> Array:
    """The points (n, 3) m from which the task draws its targets, in its order.

    Those of the four centrelines that lie within no other; of the few outside the lumen, the lumen's nearest.
    """
    from scipy.spatial import cKDTree

    assert phantom.source is not None
    # as rounded there, so that none is more or less
    curves = {
        name: Curve(*((values / MM).astype(np.float32).astype(np.float64) for values in curve))
        for name, curve in published_curves(Path(phantom.source["path"])).items()
    }
    points = np.concatenate([curves[name].points for name in TARGETS])
    for name in {*curves} - {*TARGETS}:
        away = np.linalg.norm(points[:, None] - curves[name].points, axis=2)
        points = points[(away >= curves[name].radius).all(axis=1)]
    points *= MM
    out = phantom.grid.sample(points) <= 0
    inside = phantom.grid.coordinates(phantom.grid.inside())
    points[out] = inside[cKDTree(inside).query(points[out])[1]]
    return points


def build_tree(curves: dict[str, Curve], grid: SignedDistanceGrid) -> VesselTree:
    """The tree of the published centrelines (m, patient's frame) in a lumen; those that leave it end there."""
    branches: dict[str, Branch] = {}
    for name, parent, follows in VESSELS:
        points = smoothed(resampled(_joined([_directed(curves, one) for one in follows]), STEP), _SMOOTHING)
        start = 0.0
        if parent is not None:
            points, start = _from_parent(points, branches[parent])
        out = np.flatnonzero(np.convolve(grid.sample(points) <= 0, np.ones(_LEAVES), "valid") == _LEAVES)
        points = points[: max(int(out[0]), _LEAST)] if len(out) else points
        outside = 0 if parent is None else _first_outside(points, branches[parent])
        branches[name] = Branch(name, points, measured_radii(points, grid, outside), parent, start)
    return VesselTree(tuple(replace(one, open_end=_ends(one, branches)) for one in branches.values()))


def _ends(branch: Branch, branches: dict[str, Branch]) -> bool:
    """Whether no other branch goes on from a branch's end, or meets it there."""
    others = np.concatenate([other.points for other in branches.values() if other is not branch])
    return bool(np.linalg.norm(others - branch.points[-1], axis=1).min() > 2 * JOIN_TOLERANCE)


def _directed(curves: dict[str, Curve], name: str) -> Array:
    return curves[name].points if name in curves else curves[name[1:]].points[::-1]


def _joined(pieces: list[Array]) -> Array:
    """One line of several; a piece that begins amid the one before cuts it there."""
    line = pieces[0]
    for piece in pieces[1:]:
        at = int(np.argmin(np.linalg.norm(line - piece[0], axis=1)))
        line = np.concatenate([line[:at], piece])
    return line


def _from_parent(points: Array, parent: Branch) -> tuple[Array, float]:
    """The part of a centreline beyond its parent's, from its foot there on, and that foot's arc length m."""
    _, arc, distance = nearest_on_branch(parent, points)
    first = int(np.flatnonzero(distance > JOIN_TOLERANCE / 2)[0])
    start = float(arc[max(first - 1, 0)])
    foot = parent.point_at(start)
    return resampled(np.concatenate([foot[None], points[first:]]), STEP), start


def _first_outside(points: Array, parent: Branch) -> int:
    _, arc, distance = nearest_on_branch(parent, points)
    beyond = np.flatnonzero(distance > parent.radius_at(arc))
    return int(beyond[0]) if len(beyond) else 0
