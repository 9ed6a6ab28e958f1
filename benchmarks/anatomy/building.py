"""Anatomy: how many random arches are valid, and what building and loading a phantom costs.

Every seed is drawn, built at the given resolution with its geodesic fields, and checked (open ends, one chamber,
2 mm of radius on the way to every target). Prints a table and, as its last line, one JSON object.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

import numpy as np  # noqa: E402 - after the thread limits, which it reads once

from cathsim.anatomy import PHANTOMS, load_phantom  # noqa: E402
from cathsim.anatomy.generator.random_arch import sample_parameters  # noqa: E402
from cathsim.anatomy.library import build_phantom  # noqa: E402
from cathsim.anatomy.lumen_report import check_lumen  # noqa: E402


def build_and_check(job: tuple[int, float]) -> tuple[int, float, float, tuple[str, ...], float]:
    """Builds one random phantom and checks it: seed, wall and processor seconds, problems, least radius in m."""
    seed, resolution = job
    start, start_cpu = time.perf_counter(), time.process_time()
    parameters = sample_parameters(np.random.default_rng(seed))
    phantom = build_phantom(f"random_{seed}", parameters, resolution=resolution)
    fields = [phantom.geodesic_field(target) for target in phantom.targets]
    wall, cpu = time.perf_counter() - start, time.process_time() - start_cpu
    report = check_lumen(phantom)
    problems = report.problems
    entry = phantom.entry().position
    if not all(np.isfinite(field.blocks.nodes).all() for field in fields):
        problems += ("a geodesic field is not finite.",)
    for target in ("bca", "lcca", "lsa"):
        if target not in phantom.targets or not 0.05 < phantom.geodesic_distance(entry, target) < 0.35:
            problems += (f"the way to {target} has an implausible length.",)
    return seed, wall, cpu, problems, min(report.least_radius.values())


def named_phantoms(resolution: float, directory: Path) -> list[tuple[str, float, float]]:
    """Cold seconds (build and write) and warm seconds (read, with one geodesic field) of each named phantom."""
    from cathsim.anatomy import library

    rows = []
    for name in PHANTOMS:
        start = time.perf_counter()
        load_phantom(name, resolution=resolution, cache_dir=directory)
        cold = time.perf_counter() - start
        warm = []
        for _ in range(3):
            library._load.cache_clear()
            start = time.perf_counter()
            load_phantom(name, resolution=resolution, cache_dir=directory).geodesic_field("bca")
            warm.append(time.perf_counter() - start)
        rows.append((name, cold, float(np.median(warm))))
    return rows


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer seeds, under 50 s")
    parser.add_argument("--seeds", type=int, default=None, help="how many random arches (500; 16 with --quick)")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--resolution", type=float, default=1e-3, help="m between lattice points")
    arguments = parser.parse_args()
    seeds = arguments.seeds if arguments.seeds is not None else (16 if arguments.quick else 500)

    with tempfile.TemporaryDirectory() as directory:
        rows = named_phantoms(arguments.resolution, Path(directory))
    print(f"{'phantom':<18}{'cold s':>9}{'warm s':>9}")
    for name, cold, warm in rows:
        print(f"{name:<18}{cold:>9.2f}{warm:>9.3f}")

    start = time.perf_counter()
    jobs = [(seed, arguments.resolution) for seed in range(seeds)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.processes, mp_context=context) as pool:
        results = list(pool.map(build_and_check, jobs, chunksize=5))
    elapsed = time.perf_counter() - start
    valid = sum(not problems for _, _, _, problems, _ in results)
    seconds = np.array([wall for _, wall, _, _, _ in results])
    processor = np.array([cpu for _, _, cpu, _, _ in results])
    for seed, _, _, problems, _ in results:
        for problem in problems:
            print(f"seed {seed}: {problem}")
    least = np.array([radius for _, _, _, _, radius in results]) * 1e3
    print(f"\n{seeds} random arches on {arguments.processes} processes in {elapsed:.0f} s: {valid} valid")
    print(f"build s: median {np.median(seconds):.2f}, p95 {np.percentile(seconds, 95):.2f}, max {seconds.max():.2f}")
    print(f"of it processor s: median {np.median(processor):.2f}, max {processor.max():.2f}")
    print(f"narrowest radius on the way to a target, mm: median {np.median(least):.2f}, least {least.min():.2f}")
    figures = {
        "seeds": seeds,
        "valid": valid,
        "build_s": round(float(np.median([cold for _, cold, _ in rows])), 3),
        "warm_s": round(float(np.median([warm for _, _, warm in rows])), 4),
        "random_build_s": round(float(np.median(seconds)), 3),
        "random_build_cpu_s": round(float(np.median(processor)), 3),
        "resolution_m": arguments.resolution,
        "least_radius_mm": round(float(least.min()), 3),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
