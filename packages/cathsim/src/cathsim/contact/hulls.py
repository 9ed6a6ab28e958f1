"""Convex decomposition of a vessel's wall with CoACD, cached on disk by content.

What is decomposed is the solid wall between the lumen and an outer surface. The lumen turned inside out would be one
solid with a hole, whose convex parts close the hole.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.phantom_cache import default_cache_directory, write_archive
from cathsim.anatomy.surface import MAXIMUM_WALL, wall_surface
from cathsim.validation import Count, Unit, settings

if TYPE_CHECKING:
    import trimesh

logger = logging.getLogger(__name__)

DECOMPOSITION_VERSION = 1  # raise it whenever the same settings give other hulls
CONTACTS = ("sdf", "hulls")  # backends for contact between wire and wall
# CoACD's search, made three times as fast as by default at the same fit
SAMPLES, CUTS, DEPTH = 1000, 10, 2


@settings
class Decomposition:
    """How finely a wall is cut into convex hulls.

    Attributes:
        threshold: greatest concavity of a part, as a share of half the phantom's largest extent; smaller gives more
            hulls. At 0.05 hulls of an aortic arch close its branches.
        thickness: of the wall, m. A thicker one holds a wire that is pushed hard.
        lattice: distance between the points of which the wall's surfaces are made, m; never finer than the phantom's.
        search: tries of CoACD's tree search for each cut; more give a few hulls less and take longer.
    """

    threshold: Annotated[float, Interval(ge=0.01, le=1)] = 0.02  # CoACD's range
    thickness: Annotated[float, Interval(gt=0, le=MAXIMUM_WALL), Unit("m")] = 3.0e-3
    lattice: Annotated[float, Interval(gt=0, le=0.1), Unit("m")] = 2.0e-3
    search: Count = 60
    seed: Annotated[int, Interval(ge=0, lt=2**32)] = 0


@dataclass(frozen=True, eq=False)
class Hull:
    """One convex part of a wall."""

    vertices: NDArray[np.float64]  # m, world frame. Shape (n, 3).
    faces: NDArray[np.int32]  # indices of its triangles' corners, outward. Shape (f, 3), int32.

    def planes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Outward unit normals (f, 3) and offsets (f,) m: inside is `normals @ point <= offsets`."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        size = np.linalg.norm(normals, axis=1)
        keep = size > 1e-15  # needles have no direction
        normals = normals[keep] / size[keep, None]
        return normals, np.einsum("ij,ij->i", normals, a[keep])


def decomposition(contact: str | Decomposition) -> Decomposition:
    """How finely a wall is cut, from a simulation's argument `contact`.

    Raises:
        ValueError: an unknown backend.
    """
    if isinstance(contact, Decomposition):
        return contact
    if contact != "hulls":
        raise ValueError(f"unknown contact '{contact}'; there are {', '.join(CONTACTS)}, or a Decomposition")
    return Decomposition()


def wall_hulls(phantom: Phantom, settings: Decomposition | None = None, *, cache_dir: Path | None = None) -> list[Hull]:
    """The convex hulls of a phantom's wall, from the disk cache or by decomposing it, which takes minutes.

    Raises:
        ImportError: CoACD is not installed and the cache has no such hulls.
    """
    settings = settings or Decomposition()
    directory = default_cache_directory() if cache_dir is None else Path(cache_dir)
    path = directory / "hulls" / f"{_digest(phantom, settings)}.npz"
    hulls = _read(path)
    if hulls is None:
        hulls = decompose(phantom, settings)
        _write(path, hulls)
    return hulls


def decompose(phantom: Phantom, settings: Decomposition) -> list[Hull]:
    """Decomposes a phantom's wall without any cache.

    Raises:
        ImportError: CoACD is not installed.
    """
    try:
        import coacd
    except ImportError as error:
        raise ImportError(
            "contact='hulls' needs CoACD to cut the wall into convex hulls: pip install 'endonav-cathsim[hulls]'"
        ) from error
    # visible without any set-up of logging: a user who waits for minutes wants to know for what
    logger.warning(
        "cutting the wall of %s into convex hulls (threshold %g): this takes minutes and is kept",
        phantom.name,
        settings.threshold,
    )
    wall = wall_solid(phantom, settings)
    coacd.set_log_level("error")
    start = time.monotonic()
    # a closed mesh is cut as it is; CoACD's own remeshing would fill a thin wall's lumen
    parts = coacd.run_coacd(
        coacd.Mesh(wall.vertices, wall.faces),
        threshold=settings.threshold,
        preprocess_mode="off" if wall.is_watertight else "auto",
        resolution=SAMPLES,
        mcts_nodes=CUTS,
        mcts_max_depth=DEPTH,
        mcts_iterations=settings.search,
        seed=settings.seed,
    )
    logger.info("%d hulls of %s in %.0f s", len(parts), phantom.name, time.monotonic() - start)
    return [_convex(np.asarray(vertices, float)) for vertices, _ in parts]


def wall_solid(phantom: Phantom, settings: Decomposition) -> trimesh.Trimesh:
    """The wall as a closed solid on the settings' lattice, m, world frame."""
    stride = max(1, round(settings.lattice / phantom.grid.spacing))
    return wall_surface(phantom.grid.coarser(stride), phantom.tree, settings.thickness)


def _convex(points: NDArray[np.float64]) -> Hull:
    """The hull of points with its triangles turned outward."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = hull.simplices.copy()
    faces[inward] = faces[inward][:, ::-1]
    used, renumbered = np.unique(faces, return_inverse=True)
    return Hull(points[used], renumbered.reshape(faces.shape).astype(np.int32))


def _digest(phantom: Phantom, settings: Decomposition) -> str:
    content = {"phantom": phantom.hash, "version": DECOMPOSITION_VERSION, "coacd": _coacd_version(), **asdict(settings)}
    return hashlib.blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=16).hexdigest()


def _coacd_version() -> str:
    try:
        return version("coacd")
    except PackageNotFoundError:
        return "1.0.14"  # the version that the extra installs


def _read(path: Path) -> list[Hull] | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            vertices, faces, ends = file["vertices"], file["faces"], file["ends"]
        hulls, start = [], np.zeros(2, int)
        for end in ends:
            hulls.append(Hull(vertices[start[0] : end[0]], faces[start[1] : end[1]]))
            start = end
        if not hulls:
            raise ValueError("it is empty")
    except Exception as error:  # a damaged archive raises a dozen kinds
        logger.warning("cached hulls %s are damaged (%s) and are built again.", path, error)
        return None
    return hulls


def _write(path: Path, hulls: list[Hull]) -> None:
    arrays = {
        "vertices": np.concatenate([hull.vertices for hull in hulls]),
        "faces": np.concatenate([hull.faces for hull in hulls]),
        "ends": np.cumsum([(len(hull.vertices), len(hull.faces)) for hull in hulls], axis=0),
    }
    write_archive(path, arrays, "the hulls are", compressed=True)
