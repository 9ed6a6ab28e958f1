"""Success of the sampling expert on Type I and II, BCA and LCCA.

    python benchmarks/cathsim/expert.py [--quick] [--seeds N] [--catheter NAME] [--phantoms type_1,type_2] [--console]

Twenty seeds a task, 8 mm, at most 300 steps; with --catheter a wire in a catheter. Prints a table and, as its last
line, one JSON object with a key a task, "type_1/bca": {success_pct, steps_mean, force_mean_n, force_max_n, seconds,
seeds}: steps of the successful episodes, mean over the steps and largest of the resultant contact force, processor
seconds an episode. --quick takes as many seeds as fit into about half a minute; --console searches with the fewer plans
of the console's score.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv
from cathsim.console.expert import ONE_DEVICE_SEARCH, TWO_DEVICE_SEARCH
from cathsim.planning.sampling import SamplingExpert

TARGETS = ("bca", "lcca")
QUICK_SECONDS = 30.0


def episode(phantom: str, target: str, seed: int, catheter: str | None, *, console: bool) -> dict[str, float]:
    """Runs one episode; steps, success, mean and largest force, and processor seconds."""
    environment = NavigateEnv(phantom, target, catheter=catheter, observation="tip")
    search = TWO_DEVICE_SEARCH if catheter else ONE_DEVICE_SEARCH
    expert = SamplingExpert(environment, seed=seed, settings=search if console else None)
    start = time.process_time()
    environment.reset(seed=seed)
    forces, done = [], False
    info: dict[str, Any] = {}
    while not done:
        _, _, terminated, truncated, info = environment.step(expert.action())
        forces.append(info["force"])
        done = terminated or truncated
    expert.close()
    return {
        "steps": environment.steps,
        "success": float(info["success"]),
        "force": max(forces),
        "force_mean": float(np.mean(forces)),
        "seconds": time.process_time() - start,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="as many seeds as fit into half a minute")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--catheter", help="over the wire: a name of the shelf, or a YAML file")
    parser.add_argument("--phantoms", default="type_1,type_2", help="names, by commas")
    parser.add_argument("--console", action="store_true", help="with the searches of the console's score")
    arguments = parser.parse_args()
    tasks = tuple(itertools.product(arguments.phantoms.split(","), TARGETS))
    began = time.perf_counter()
    runs: dict[str, list[dict[str, float]]] = {f"{phantom}/{target}": [] for phantom, target in tasks}
    for seed in range(arguments.seeds):
        for phantom, target in tasks:
            made = episode(phantom, target, seed, arguments.catheter, console=arguments.console)
            runs[f"{phantom}/{target}"].append(made)
        if arguments.quick and time.perf_counter() - began > QUICK_SECONDS / 2:
            break
    forces = f"{'force mean, N':>15s}{'force max, N':>14s}"
    print(f"{'task':14s}{'seeds':>7s}{'success %':>11s}{'steps':>8s}{forces}{'CPU s':>8s}")
    result = {}
    for task, episodes in runs.items():
        successful = [e["steps"] for e in episodes if e["success"]]
        row = {
            "success_pct": 100 * float(np.mean([e["success"] for e in episodes])),
            "steps_mean": float(np.mean(successful)) if successful else None,
            "force_mean_n": float(np.mean([e["force_mean"] for e in episodes])),
            "force_max_n": max(e["force"] for e in episodes),
            "seconds": float(np.mean([e["seconds"] for e in episodes])),
            "seeds": len(episodes),
        }
        result[task] = {key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()}
        steps = f"{row['steps_mean']:.0f}" if successful else "-"
        print(
            f"{task:14s}{row['seeds']:7d}{row['success_pct']:11.0f}{steps:>8s}"
            f"{row['force_mean_n']:15.3f}{row['force_max_n']:14.3f}{row['seconds']:8.1f}"
        )
    print(json.dumps(result))


if __name__ == "__main__":
    main()
