"""ArchVariety: the arches beside published ones, and the sampling expert in each branching type.

    python benchmarks/cathsim/arch_variety.py sizes [--seeds N] [--published FOLDER]
    python benchmarks/cathsim/arch_variety.py expert [--types I,IV] [--arches N] [--catheter NAME] [--wire NAME]

"sizes" prints lengths, radii and rises (of a branch's chord over the horizontal) of the branches of N arches a type,
and where a folder with the published generator's `branches.json` is given, those of its arches, marked * where they
lie outside our middle 98 %. "expert" runs one episode in each of N arches of the test seeds a type, to a random target,
at most 450 steps and --rollouts roll-outs; it prints a line an episode, a table, and as its last line one JSON object
with a key a type: {success_pct, n, steps_mean, force_mean_n, force_max_n, seconds}.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim.anatomy.generator.variety.branching_types import ARCH_TYPES
from cathsim.anatomy.generator.variety.variety_arch import VarietyArch, build_variety_arch
from cathsim.arch_variety.environment import TEST_SEEDS, ArchVarietyEnv
from cathsim.metrics.intervals import wilson_interval
from cathsim.planning.sampling import SamplingExpert

PUBLISHED_NAMES = {"bct": ("bca", "carotid_trunk"), "co": ("carotid_trunk", "subclavian_trunk")}


def rise(start: np.ndarray, end: np.ndarray) -> float:
    """Angle of a chord to the horizontal, degrees."""
    way = np.asarray(end) - np.asarray(start)
    return float(np.degrees(np.arcsin(way[2] / np.linalg.norm(way))))


def our_sizes(kind: str, seeds: int) -> dict[str, np.ndarray]:
    """Length, least and largest radius (mm) and rise (degrees) of each branch in each arch of a type."""
    rows = defaultdict(list)
    for seed in range(seeds):
        for branch in build_variety_arch(VarietyArch(kind, seed)):
            sizes = branch.length, branch.radius.min(), branch.radius.max()
            rows[branch.name].append((*(1e3 * size for size in sizes), rise(branch.points[0], branch.points[-1])))
    return {name: np.array(values) for name, values in rows.items()}


def published_sizes(folder: Path, kind: str) -> dict[str, list[tuple[float, ...]]]:
    """The same of the published generator's arches, by our names."""
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for file, branches in json.loads((folder / "branches.json").read_text()).items():
        if file.split("_")[1] != kind:
            continue
        for name, one in branches.items():
            known = name
            if name in PUBLISHED_NAMES:  # a trunk is called after what it carries
                known = PUBLISHED_NAMES[name][kind == "VI" if name == "co" else kind in ("V", "VI")]
            rows[known].append((one["length_mm"], *one["radius_mm"], rise(one["start"], one["end"])))
    return rows


def print_sizes(seeds: int, folder: Path | None) -> dict[str, Any]:
    """Prints the table of sizes; share of published values within our middle 98 %."""
    print(f"{'type':<5}{'branch':<18}{'length, mm':>16}{'least radius':>16}{'largest radius':>16}{'rise, deg':>14}")
    inside = total = 0
    for kind in ARCH_TYPES:
        theirs = published_sizes(folder, kind) if folder else {}
        for name, ours in our_sizes(kind, seeds).items():
            cells = [f"{mean:.1f} +- {spread:.1f}" for mean, spread in zip(ours.mean(0), ours.std(0), strict=True)]
            print(f"{kind:<5}{name:<18}{cells[0]:>16}{cells[1]:>16}{cells[2]:>16}{cells[3]:>14}")
            low, high = np.percentile(ours, [1, 99], axis=0)
            for row in theirs.get(name, ()):
                within = (np.array(row) >= low) & (np.array(row) <= high)
                inside, total = inside + int(within.sum()), total + len(row)
                marks = [f"{value:.1f}{' ' if ok else '*'}" for value, ok in zip(row, within, strict=True)]
                print(f"{'':<5}{'  published':<18}{marks[0]:>16}{marks[1]:>16}{marks[2]:>16}{marks[3]:>14}")
    return {"arches_a_type": seeds, "published_values": total, "within_98_pct": inside}


def episode(environment: ArchVarietyEnv, case: int, seed: int, rollouts: int) -> dict[str, Any]:
    """One episode of the expert."""
    start = time.process_time()
    _, info = environment.reset(seed=seed, options={"case": case})
    expert = SamplingExpert(environment.current, seed=seed, threads=1)
    forces, done = [], False
    while not done and expert.rollouts < rollouts:
        _, _, terminated, truncated, info = environment.step(expert.action())
        forces.append(info["force"])
        done = terminated or truncated
    expert.close()
    place = environment.phantom.target(environment.task.target)
    return {
        "phantom": info["phantom"],
        "branch": place.branch,
        "success": bool(info["success"]),
        "steps": len(forces),
        "force_mean": float(np.mean(forces)),
        "force_max": max(forces),
        "seconds": time.process_time() - start,
    }


def run_expert(chosen: argparse.Namespace) -> dict[str, Any]:
    """Episodes in every type; the table, printed."""
    arguments = {"catheter": chosen.catheter} if chosen.catheter else {}
    seeds = TEST_SEEDS[: chosen.arches]
    kinds = chosen.types.split(",")
    environment = ArchVarietyEnv(kinds, seeds, wires=(chosen.wire,), **arguments)
    results: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    for number in range(len(seeds)):
        for index, kind in enumerate(kinds):
            result = episode(environment, environment.case_of(index * len(seeds) + number), number, chosen.rollouts)
            results[kind].append(result)
            print(json.dumps(result), flush=True)
    print(f"{'type':<5}{'n':>4}{'success, %':>18}{'steps':>8}{'force, N':>10}{'most, N':>9}{'CPU s':>8}")
    table = {kind: summary(rows) for kind, rows in results.items()}
    for kind, row in table.items():
        low, high = wilson_interval(round(row["success_pct"] * row["n"] / 100), row["n"])
        shown = f"{row['success_pct']:.0f} ({100 * low:.0f}-{100 * high:.0f})"
        steps, forces = row["steps_mean"], (row["force_mean_n"], row["force_max_n"])
        print(
            f"{kind:<5}{row['n']:>4}{shown:>18}{steps:>8.0f}{forces[0]:>10.3f}{forces[1]:>9.2f}{row['seconds']:>8.1f}"
        )
    return table


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Success in %, mean steps of the successful episodes, forces, processor seconds an episode."""
    reached = [row["steps"] for row in rows if row["success"]]
    return {
        "success_pct": 100 * len(reached) / len(rows),
        "n": len(rows),
        "steps_mean": float(np.mean(reached)) if reached else float("nan"),
        "force_mean_n": float(np.mean([row["force_mean"] for row in rows])),
        "force_max_n": max(row["force_max"] for row in rows),
        "seconds": float(np.mean([row["seconds"] for row in rows])),
    }


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("sizes", "expert"))
    parser.add_argument("--seeds", type=int, default=50, help="arches a type of the table of sizes")
    parser.add_argument("--published", type=Path, help="folder with branches.json")
    parser.add_argument("--types", default=",".join(ARCH_TYPES))
    parser.add_argument("--arches", type=int, default=10, help="arches a type of the expert's episodes")
    parser.add_argument("--catheter")
    parser.add_argument("--wire", default="arch_variety")
    parser.add_argument("--rollouts", type=int, default=2400, help="after which an episode counts as failed")
    chosen = parser.parse_args()
    result = print_sizes(chosen.seeds, chosen.published) if chosen.what == "sizes" else run_expert(chosen)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
