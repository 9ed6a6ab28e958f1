"""Import of an anatomy from files, and whether the sampling expert finds its way in it.

    python benchmarks/anatomy/mesh_import.py PATH [--quick] [--unit mm] [--seeds N] [--targets bca,lcca]

Builds the phantom without any cache, checks its lumen, and steers the default wire, made as long as the ways need, from
the femoral end to each target: 8 mm, at most 300 steps. Prints tables and, as its last line, one JSON object:
build_s (wall clock) and build_cpu_s, grid_points, faces, unit, kind, branches, names, problems of the lumen, wire_mm,
success_pct over all episodes, and per target {success_pct, steps_mean, force_max_n, seconds, seeds}. --quick: one seed,
and no new episode once 25 s have gone by since the import's end; the first one is always played.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.cathsim.expert import episode
from cathsim import load_guidewire
from cathsim.anatomy import MeshRefusedError, Phantom, import_anatomy
from cathsim.anatomy.lumen_report import check_lumen
from cathsim.guidewire import Guidewire

QUICK_SECONDS = 25.0


def wire_for(phantom: Phantom, targets: list[str]) -> Guidewire:
    """The default wire, as long as the longest way and a fifth more: it does not follow the centreline."""
    wire = load_guidewire("default")
    longest = max(phantom.way_length(target) for target in targets)
    return wire.scaled(max(wire.length, math.ceil((1.2 * longest + 0.04) / 0.008) * 0.008))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path, help="a surface, a label volume, or a folder of them")
    parser.add_argument("--quick", action="store_true", help="one seed, under 30 s beside the import")
    parser.add_argument("--unit", default=None)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--targets", default="bca,lcca")
    arguments = parser.parse_args()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as directory:
        cpu = time.process_time()
        try:
            phantom = import_anatomy(arguments.path, unit=arguments.unit, cache_dir=Path(directory))
        except MeshRefusedError as error:
            sys.exit(f"refused: {error.reason}")
        build_s, build_cpu_s = time.perf_counter() - began, time.process_time() - cpu
    report = phantom.imported
    assert report is not None
    problems = check_lumen(phantom).problems
    print(f"{report.file}: {report.faces} faces, {report.kind}, unit {report.unit} ({report.unit_reason})")
    print(f"built in {build_s:.1f} s ({build_cpu_s:.1f} s of processor)")
    for note in (*report.notes, *problems):
        print(f"  {note}")
    print(f"{'branch':12s}{'from':12s}{'length, mm':>12s}{'radius, mm':>12s}")
    for branch in phantom.tree:
        radius = float(np.median(branch.radius))
        print(f"{branch.name:12s}{branch.parent or '-':12s}{branch.length * 1e3:12.0f}{radius * 1e3:12.1f}")

    targets = [target for target in arguments.targets.split(",") if target in phantom.targets]
    result: dict[str, object] = {
        "build_s": round(build_s, 2),
        "build_cpu_s": round(build_cpu_s, 2),
        "faces": report.faces,
        "unit": report.unit,
        "kind": report.kind,
        "grid_points": int(np.prod(phantom.grid.shape)),
        "branches": len(phantom.tree.branches),
        "names": list(phantom.tree.names),
        "problems": list(problems),
    }
    if targets:
        wire = wire_for(phantom, targets)
        result["wire_mm"] = round(wire.length * 1e3)
        runs: dict[str, list[dict[str, float]]] = {target: [] for target in targets}
        built = time.perf_counter()
        for seed in range(1 if arguments.quick else arguments.seeds):
            for target in targets:
                played = any(runs.values())
                if arguments.quick and played and time.perf_counter() - built > QUICK_SECONDS:
                    print(f"  no time left for {target}")
                    continue
                runs[target].append(episode(phantom, target, seed, wire))
        print(f"{'target':12s}{'seeds':>7s}{'success %':>11s}{'steps':>8s}{'force max, N':>14s}{'CPU s':>8s}")
        done = [e["success"] for episodes in runs.values() for e in episodes]
        result["success_pct"] = round(100 * float(np.mean(done)), 1) if done else None
        for target, episodes in runs.items():
            if not episodes:
                continue
            steps = [e["steps"] for e in episodes if e["success"]]
            row = {
                "success_pct": round(100 * float(np.mean([e["success"] for e in episodes])), 1),
                "steps_mean": round(float(np.mean(steps)), 1) if steps else None,
                "force_max_n": round(max(e["force"] for e in episodes), 3),
                "seconds": round(float(np.mean([e["seconds"] for e in episodes])), 1),
                "seeds": len(episodes),
            }
            result[target] = row
            mean = "-" if row["steps_mean"] is None else f"{row['steps_mean']:.0f}"
            print(
                f"{target:12s}{row['seeds']:7d}{row['success_pct']:11.0f}{mean:>8s}{row['force_max_n']:14.2f}"
                f"{row['seconds']:8.1f}"
            )
    print(json.dumps(result))


if __name__ == "__main__":
    main()
