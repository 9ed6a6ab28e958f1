"""Robustness of imports: an anatomy as it is, turned, mirrored, in other units, inside out, torn, coarse and fine.

    python benchmarks/anatomy/variants.py PATH|FOLDER [--variants rotated,mirrored] [--seed N] [--quick]

Every surface (STL, OBJ, PLY, VTP, GLB) and every label volume (a NIfTI file or a folder of them) at or below the path
is imported as it is and in these variants, each in a process of its own and without any cache:

    rotated       turned at random about all axes (labels: by the affine)
    mirrored      left and right exchanged; right if its names are the original's, or a note says that it is a mirror
                  image, or that left and right cannot be told
    m, cm, mm     written in that unit (labels: m, micron, mm, as the header says)
    flipped       normals the other way (labels: voxels stored the other way round)
    torn          1 % of its faces or labelled voxels missing, drawn at random
    decimated     to 10 % of its faces, by merging vertices in cells: coarser than edge collapses of the same number
                  (labels: every second voxel along each axis)
    subdivided    each face in four (labels: each voxel in eight)

A variant is right if its lumen has no problem, its branches are the original's and the distances between its targets
are the original's within 5 mm, where both have the same targets. Prints a table and, as its last line, one JSON object:
{"files": {name: {"original": row, "variants": {variant: row}}}, "right", "tried"}; rows are those of
benchmarks/anatomy_import.py, with "right" and "moved_mm", the largest change of a distance between two targets.
--quick: the variants mirrored, torn and decimated alone.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.anatomy import volume_variants
from benchmarks.anatomy.volume_variants import TORN
from benchmarks.anatomy_import import SECONDS, anatomies, measure_apart
from cathsim.anatomy.mesh.parts.vessel_parts import read_parts
from cathsim.anatomy.mesh.reading import SCENES, SUFFIXES, UNITS

KEPT = 0.1  # share of the faces that is left
QUICK = ("mirrored", "torn", "decimated")
MOVED = 5.0  # mm: largest change of a distance between two targets
MIRRORED_NOTES = ("mirror image", "left and right cannot be told")
_MOST_ROUNDS = 24  # halvings of the size of the cells

Vertices, Faces = NDArray[np.float64], NDArray[np.int64]
Surface = tuple[Vertices, Faces]


def rotated(surface: Surface, generator: np.random.Generator) -> Surface:
    """Turned at random: all rotations are as likely."""
    turn, _ = np.linalg.qr(generator.standard_normal((3, 3)))
    turn[:, 0] *= np.linalg.det(turn)
    return surface[0] @ turn.T, surface[1]


def mirrored(surface: Surface, generator: np.random.Generator) -> Surface:
    """Left and right exchanged, normals as before."""
    return surface[0] * [-1.0, 1.0, 1.0], surface[1][:, ::-1]


def flipped(surface: Surface, generator: np.random.Generator) -> Surface:
    """Normals the other way."""
    return surface[0], surface[1][:, ::-1]


def torn(surface: Surface, generator: np.random.Generator) -> Surface:
    """Faces missing, drawn at random."""
    return surface[0], surface[1][generator.random(len(surface[1])) >= TORN]


def decimated(surface: Surface, generator: np.random.Generator) -> Surface:
    """Vertices merged in cells as large as leaves a tenth of the faces."""
    vertices, faces = surface
    low, high = 0.0, float(np.ptp(vertices, axis=0).max()) / 4
    for _ in range(_MOST_ROUNDS):
        cell = (low + high) / 2
        merged = _merged(vertices, faces, cell)
        low, high = (cell, high) if len(merged[1]) > KEPT * len(faces) else (low, cell)
    return _merged(vertices, faces, high)


def _merged(vertices: Vertices, faces: Faces, cell: float) -> Surface:
    _, group = np.unique(np.floor(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    group = group.ravel()
    counts = np.bincount(group)[:, None]
    means = np.stack([np.bincount(group, vertices[:, k]) for k in range(3)], axis=1) / counts
    left = group[faces]
    left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 2] != left[:, 0])]
    _, first = np.unique(np.sort(left, axis=1), axis=0, return_index=True)
    return means, left[np.sort(first)]


def subdivided(surface: Surface, generator: np.random.Generator) -> Surface:
    """Each face in four."""
    import trimesh

    vertices, faces = trimesh.remesh.subdivide(*surface)
    return np.asarray(vertices, np.float64), np.asarray(faces, np.int64)


CHANGES: dict[str, Callable[[Surface, np.random.Generator], Surface]] = {
    change.__name__: change for change in (rotated, mirrored, flipped, torn, decimated, subdivided)
}
VARIANTS = ("rotated", "mirrored", "m", "cm", "mm", "flipped", "torn", "decimated", "subdivided")


def write_variant(path: Path, variant: str, unit: str, folder: Path, seed: int) -> Path:
    """Writes a variant of a surface's file: an STL, or of a scene a GLB whose parts have their vessels' names.

    Args:
        unit: of the file.
    """
    import trimesh

    generator = np.random.default_rng(seed)
    named: dict[str, trimesh.Trimesh] = {}
    for number, part in enumerate(read_parts(path).parts):
        corners = part.mesh.corners
        vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        surface = vertices, index.reshape(-1, 3).astype(np.int64)
        if variant in CHANGES:
            surface = CHANGES[variant](surface, np.random.default_rng(seed) if variant == "rotated" else generator)
        else:
            surface = surface[0] * (UNITS[unit] / UNITS[variant]), surface[1]
        named[f"{part.name}_{number}" if part.name else str(number)] = trimesh.Trimesh(*surface, process=False)
    if path.suffix.lower() not in SCENES:
        file = folder / f"{path.stem}_{variant}.stl"
        trimesh.util.concatenate(list(named.values())).export(file)
        return file
    file = folder / f"{path.stem}_{variant}.glb"
    whole = trimesh.Scene()
    for name, mesh in named.items():
        whole.add_geometry(mesh, node_name=name, geom_name=name)
    whole.export(file)
    return file


def moved(row: dict[str, Any], original: dict[str, Any]) -> float | None:
    """Largest change of a distance between two targets, mm; None if the targets' names differ."""
    places, before = row["places_mm"], original["places_mm"]
    if set(places) != set(before):
        return None
    pairs = itertools.combinations(sorted(places), 2)
    changes = [abs(math.dist(places[a], places[b]) - math.dist(before[a], before[b])) for a, b in pairs]
    return round(max(changes, default=0.0), 2)


def is_right(row: dict[str, Any], original: dict[str, Any], variant: str) -> bool:
    """Whether a variant's lumen is whole and its branches are the original's, or it says that it is mirrored."""
    if not row["ok"]:
        return False
    said = any(words in note for note in row["notes"] for words in MIRRORED_NOTES)
    if set(row["branches"]) != set(original["branches"]):
        return variant == "mirrored" and said
    off = moved(row, original)
    return off is not None and off <= MOVED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path, help="a surface, a label volume, or a folder")
    parser.add_argument("--variants", help="some of them, with commas between; all unless given")
    parser.add_argument("--seed", type=int, default=0, help="of the rotation and of what is missing")
    parser.add_argument("--resolution", type=float, default=1.0, help="mm between lattice points")
    parser.add_argument("--quick", action="store_true", help="three variants alone")
    arguments = parser.parse_args()
    every = tuple(dict.fromkeys((*VARIANTS, *volume_variants.VARIANTS)))
    chosen = QUICK if arguments.quick else tuple(arguments.variants.split(",")) if arguments.variants else every
    if unknown := [name for name in chosen if name not in every]:
        sys.exit(f"unknown variant {unknown[0]!r}: choose from {', '.join(every)}")
    if not arguments.path.exists():
        sys.exit(f"there is no {arguments.path}; give a surface, a label volume or a folder of them.")
    resolution, files, right, tried = arguments.resolution / 1e3, {}, 0, 0
    print(f"{'file':28s}{'variant':12s}{'right':>7s}{'CPU s':>8s}{'moved mm':>10s}  branches")
    for name, path in anatomies(arguments.path).items():
        volume = volume_variants.is_volume(path)
        if not volume and (path.is_dir() or not path.name.lower().endswith(SUFFIXES)):
            continue
        possible = volume_variants.VARIANTS if volume else VARIANTS
        original = measure_apart(path, resolution, None, SECONDS)
        rows: dict[str, Any] = {}
        files[name] = {"original": original, "variants": rows}
        _print(name, "original", original["ok"], original)
        with tempfile.TemporaryDirectory() as folder:
            for variant in [v for v in chosen if v in possible] if original["unit"] else ():
                if volume:
                    file = volume_variants.write_volume_variant(path, variant, Path(folder), arguments.seed)
                else:
                    file = write_variant(path, variant, original["unit"], Path(folder), arguments.seed)
                row = measure_apart(file, resolution, None, SECONDS)
                rows[variant] = {"right": is_right(row, original, variant), "moved_mm": moved(row, original), **row}
                right, tried = right + rows[variant]["right"], tried + 1
                _print(name, variant, rows[variant]["right"], rows[variant])
    print(json.dumps({"files": files, "right": right, "tried": tried}))


def _print(name: str, variant: str, right: bool, row: dict[str, Any]) -> None:
    print(f"{name[:27]:28s}{variant:12s}{'yes' if right else 'no':>7s}{row['build_cpu_s'] or 0:8.1f}"
          f"{'-' if row.get('moved_mm') is None else format(row['moved_mm'], '.2f'):>10s}  "
          f"{', '.join(row['branches'])}{'; '.join(row['problems'])}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
