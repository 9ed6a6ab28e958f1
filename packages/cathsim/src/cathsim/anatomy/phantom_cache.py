"""Built phantoms on disk: a file each and one a geodesic field, named by content, written atomically, made again when
damaged.

Only lattice points near the lumen are stored; all others hold one constant (the distance grid's clamp, a geodesic
field's largest value).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import LatticeField, SignedDistanceGrid
from cathsim.anatomy.entry import Entry
from cathsim.anatomy.generator.recipe import Recipe
from cathsim.anatomy.geodesic import MARGIN
from cathsim.anatomy.mesh.report import ImportReport
from cathsim.anatomy.phantom import Phantom, Target
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.lattice.node_blocks import EDGE, NodeBlocks

logger = logging.getLogger(__name__)
LAYOUT = 3  # of the files; raise it whenever they are written in another way


def default_cache_directory() -> Path:
    """Where phantoms are cached, made when needed: $CATHSIM_CACHE, else `cathsim` in the user's cache directory."""
    folder = os.environ.get("CATHSIM_CACHE")
    if folder:
        return Path(folder).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(base).expanduser() / "cathsim"


def write_archive(path: Path, arrays: dict[str, NDArray], what: str, *, compressed: bool = False) -> None:
    """Writes arrays atomically as one .npz file; a folder that cannot be written to only costs a warning.

    Args:
        path: of the file; its folder is made.
        what: subject and verb of the warning, such as "the hulls are".
    """
    temporary = None
    save: Callable[..., None] = np.savez_compressed if compressed else np.savez
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".building-", suffix=".npz", delete=False) as file:
            temporary = file.name
            save(file, **arrays)
        os.umask(mask := os.umask(0))
        os.chmod(temporary, 0o666 & ~mask)  # a temporary file is private, and a cache can be shared
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        logger.warning("%s not cached: %s cannot be written (%s).", what, path.parent, error)
    finally:
        if temporary is not None:  # also after an interruption
            with contextlib.suppress(OSError):
                os.unlink(temporary)


@dataclass(frozen=True)
class PhantomCache:
    """Reads and writes built phantoms below a directory, which is made when first written to."""

    directory: Path

    def path(self, digest: str) -> Path:
        """File of a phantom of a hash, whether it exists or not."""
        return self.directory / "phantoms" / f"{digest}-{LAYOUT}.npz"

    def read(self, name: str, digest: str, parameters: Recipe | None) -> Phantom | None:
        """Reads a phantom and names it; its geodesic fields are read at first use.

        Returns:
            The phantom, or None where there is no sound file (a damaged one is reported with a warning).
        """
        path = self.path(digest)
        if not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                meta = json.loads(str(file["meta"]))
                if meta["hash"] != digest:
                    raise ValueError("it holds another phantom")
                grid = SignedDistanceGrid(_unpack(file, meta), np.array(meta["origin"]), meta["spacing"])
                points, radius = file["points"], file["radius"]
        except Exception as error:  # a damaged archive raises a dozen kinds
            logger.warning("cached phantom %s is damaged (%s) and is built again.", path, error)
            return None
        branches, start = [], 0
        for b in meta["branches"]:
            end = start + b["count"]
            branches.append(
                Branch(b["name"], points[start:end], radius[start:end], b["parent"], b["parent_arc"], b["open_end"])
            )
            start = end
        return Phantom(
            name=name,
            hash=digest,
            parameters=parameters,
            tree=VesselTree(tuple(branches)),
            grid=grid,
            targets={
                t["name"]: Target(t["name"], t["branch"], np.array(t["position"]), t["arc"]) for t in meta["targets"]
            },
            entries={
                e["name"]: Entry(e["name"], np.array(e["position"]), np.array(e["direction"])) for e in meta["entries"]
            },
            imported=ImportReport.from_json(meta["imported"]) if meta.get("imported") else None,
            _load_field=(fields := _FieldFiles(path, grid)).read,
            _save_field=fields.write,
        )

    def write(self, phantom: Phantom) -> Phantom:
        """Writes a phantom; returns it as one whose geodesic fields are written when they are first asked for."""
        grid = phantom.grid
        blocks = grid.blocks
        near = blocks.own != blocks.constant
        marched = near.any(axis=(1, 2, 3))
        meta = {
            "hash": phantom.hash,
            "shape": list(grid.shape),
            "origin": grid.origin.tolist(),
            "spacing": grid.spacing,
            "outside": blocks.constant,
            "branches": [
                {
                    "name": b.name,
                    "count": len(b.points),
                    "parent": b.parent,
                    "parent_arc": b.parent_arc,
                    "open_end": b.open_end,
                }
                for b in phantom.tree
            ],
            "targets": [
                {"name": t.name, "branch": t.branch, "position": t.position.tolist(), "arc": t.arc}
                for t in phantom.targets.values()
            ],
            "entries": [
                {"name": e.name, "position": e.position.tolist(), "direction": e.direction.tolist()}
                for e in phantom.entries.values()
            ],
        }
        if phantom.imported is not None:
            meta["imported"] = phantom.imported.to_json()
        arrays: dict[str, NDArray] = {
            "meta": np.array(json.dumps(meta)),
            "blocks": np.flatnonzero(blocks.stored)[marched].astype(np.int32),
            "near": np.packbits(near[marched]),
            "distance": blocks.own[near],
            "points": np.concatenate([b.points for b in phantom.tree]),
            "radius": np.concatenate([b.radius for b in phantom.tree]),
        }
        path = self.path(phantom.hash)
        write_archive(path, arrays, f"phantom {phantom.name} is")
        fields = _FieldFiles(path, grid)
        return replace(phantom, _load_field=fields.read, _save_field=fields.write)


@dataclass(frozen=True, eq=False)
class _FieldFiles:
    """The geodesic fields of a cached phantom, a file each."""

    phantom: Path  # the phantom's file
    grid: SignedDistanceGrid

    def _path(self, target: str) -> Path:
        name = hashlib.sha256(target.encode()).hexdigest()[:12]  # names of vessels are the user's
        return self.phantom.with_name(f"{self.phantom.stem}-{name}.npz")

    def read(self, target: str) -> LatticeField | None:
        """A field, or None where there is no sound file (a damaged one is reported with a warning)."""
        grid, path = self.grid, self._path(target)
        if not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                marched = _marched(grid)
                field_blocks = marched.any(axis=(1, 2, 3))
                farthest = float(file["farthest"])
                cores = np.full((int(field_blocks.sum()), *marched.shape[1:]), farthest, dtype=np.float32)
                cores[marched[field_blocks]] = file["geodesic"]
        except Exception as error:  # a damaged archive raises a dozen kinds
            logger.warning("geodesic field %s in %s is damaged (%s) and is computed again.", target, path, error)
            return None
        occupied = np.array(grid.blocks.stored)
        occupied[occupied] = field_blocks
        return LatticeField(NodeBlocks.from_cores(occupied, cores, grid.shape, farthest), grid.origin, grid.spacing)

    def write(self, target: str, field: LatticeField) -> None:
        """Writes a field."""
        blocks = self.grid.blocks
        arrays = {
            "geodesic": field.blocks.at(blocks.own_indices(_marched(self.grid))),
            "farthest": np.array(field.blocks.constant, dtype=np.float32),
        }
        write_archive(self._path(target), arrays, f"the distances to target {target} are")


def _marched(grid: SignedDistanceGrid) -> NDArray[np.bool_]:
    """Lattice points at which geodesic fields are more than a constant, among the stored blocks' own nodes."""
    return grid.blocks.own > -MARGIN - grid.spacing


def _unpack(file: Mapping[str, NDArray], meta: dict[str, Any]) -> NodeBlocks:
    """The stored blocks of a distance grid."""
    nx, ny, nz = (int(n) for n in meta["shape"])
    occupied = np.zeros([-(-n // EDGE) for n in (nx, ny, nz)], dtype=bool)
    occupied.reshape(-1)[file["blocks"]] = True
    cores = np.full((int(occupied.sum()), EDGE, EDGE, EDGE), meta["outside"], dtype=np.float32)
    near = np.unpackbits(file["near"], count=cores.size).view(np.bool_).reshape(cores.shape)
    cores[near] = file["distance"]
    return NodeBlocks.from_cores(occupied, cores, (nx, ny, nz), meta["outside"])
