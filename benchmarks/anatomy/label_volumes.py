"""Label volumes of generated arches, imported again: names, wall, volume and centrelines against the truth.

    python benchmarks/anatomy/label_volumes.py [--arches N] [--setting random] [--first SEED] [--resolution MM]

N arches of a setting ("random", "random_wide", "arch_variety"; seeds from --first on) are written as volumes of labels
on voxels of four sizes, one of them oblique, and imported. The table has a row a size: processor time, how far the
wall is off (mean, standard deviation, 99th percentile), the angle between its normals and the true ones, error of the
whole volume and of the worst vessel's, error of centrelines. Within 5 mm of open ends nothing is compared. The last
line is one JSON object {"rows": {size: {...}}, "arches", "missing"}.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim.anatomy import Phantom, import_anatomy, load_phantom
from cathsim.anatomy.surface import open_ends
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.rasterising import rasterise, save_nifti

TURN = 0.3  # rad about two axes, of the oblique volume
SIZES: dict[str, tuple[tuple[float, float, float], bool]] = {
    "0.7 x 0.7 x 2.5": ((0.7e-3, 0.7e-3, 2.5e-3), False),
    "0.7 x 0.7 x 2.5, oblique": ((0.7e-3, 0.7e-3, 2.5e-3), True),
    "1.5 x 1.5 x 1.5": ((1.5e-3,) * 3, False),
    "0.8 x 0.8 x 5.0": ((0.8e-3, 0.8e-3, 5e-3), False),
}
END = 5e-3  # m about open ends that are not compared


def oblique() -> np.ndarray:
    c, s = np.cos(TURN), np.sin(TURN)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def compare(found: Phantom, truth: Phantom) -> dict[str, float]:
    """What differs between an imported phantom and the one that its labels were made of."""
    assert found.imported is not None
    offset = np.array(found.imported.offset)
    mesh = found.lumen_mesh
    vertices = mesh.vertices - offset
    ends = [np.linalg.norm(vertices - centre, axis=1) < radius + END for centre, _, radius in open_ends(truth.tree)]
    kept = ~np.any(ends, axis=0)
    off = 1e3 * truth.grid.sample(vertices[kept])
    normals = -truth.grid.gradient(vertices[kept])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    angle = np.degrees(np.arccos(np.clip((normals * mesh.vertex_normals[kept]).sum(axis=1), -1, 1)))
    pairs = found.imported.volumes_ml.values()
    away = []
    for branch in truth.tree:
        if branch.name in found.tree:
            _, arc, distance = nearest_on_branch(branch, found.tree[branch.name].points - offset)
            away.append(distance[(arc > 0.3 * branch.length) & (arc < 0.9 * branch.length)])
    return {
        "wall_mean_mm": float(off.mean()),
        "wall_sd_mm": float(off.std()),
        "wall_p99_mm": float(np.percentile(np.abs(off), 99)),
        "angle_median_deg": float(np.median(angle)),
        "angle_p95_deg": float(np.percentile(angle, 95)),
        "volume_pct": 100 * abs(mesh.volume / truth.lumen_mesh.volume - 1),
        "worst_vessel_pct": 100 * max(abs(lumen / voxels - 1) for voxels, lumen in pairs),
        "centreline_p95_mm": 1e3 * float(np.percentile(np.concatenate(away), 95)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arches", type=int, default=6)
    parser.add_argument("--setting", default="random")
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--resolution", type=float, default=1.0, help="mm")
    options = parser.parse_args()
    rows: dict[str, dict[str, float]] = {}
    missing: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for size, (spacing, turned) in SIZES.items():
            measured = []
            for seed in range(options.first, options.first + options.arches):
                truth = load_phantom(options.setting, seed=seed)
                numbers = {name: number for number, name in enumerate(truth.tree.names, 1)}
                labels, affine = rasterise(truth, spacing, oblique() if turned else None, numbers)
                names = {number: name for name, number in numbers.items()}
                path = save_nifti(Path(folder) / f"{options.setting}_{seed}.nii.gz", labels, affine, names)
                began = time.process_time()
                try:
                    found = import_anatomy(path, resolution=1e-3 * options.resolution, cache_dir=Path(folder) / size)
                except ValueError as error:
                    missing.append(f"{size}, seed {seed}: {error}")
                    continue
                seconds = time.process_time() - began
                missing += [f"{size}, seed {seed}: {n}" for n in truth.tree.names if n not in found.tree and n != "sac"]
                measured.append({"cpu_s": seconds, **compare(found, truth)})
            rows[size] = {key: round(float(np.mean([m[key] for m in measured])), 3) for key in measured[0]}
            print(f"{size:26s}" + "  ".join(f"{key} {value:g}" for key, value in rows[size].items()), flush=True)
    for line in missing:
        print("missing:", line)
    print(json.dumps({"rows": rows, "arches": options.arches, "missing": missing}))


if __name__ == "__main__":
    main()
