"""Which arches with a common trunk a wire alone, and a wire with a catheter, can be steered in, by one search budget.

    python benchmarks/devices/reach.py [--arches N] [--devices wire,simmons2] [--searches N] [--output FILE.jsonl]

Random arches with a common origin of BCA and LCCA, from seed 33000 on, target LCCA. An arch counts when the wire alone
fails by the first search; then every device is steered there with each search seed. The sampling expert has the same
settings (`TWO_DEVICES`, with motion primitives) for all of them, at most 300 steps. Episodes already in the output file
are not run again. Prints a line an episode and, last, one JSON object: device to success_pct, arches, episodes,
steps_mean, force_max_n.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv, Phantom, load_guidewire, load_phantom
from cathsim.planning.sampling import TWO_DEVICES, SamplingExpert

TARGET, WIRE_LENGTH, MOST_STEPS = "lcca", 0.36, 300
FIRST_SEED = 33_000
WIRE = "wire"  # the device without a catheter


def common_trunks() -> Any:
    """Random arches with a common trunk, one after the other."""
    for seed in itertools.count(FIRST_SEED):
        phantom = load_phantom("random", seed=seed)
        if phantom.parameters is not None and phantom.parameters.bovine:
            yield phantom


def episode(phantom: Phantom, device: str, seed: int) -> dict[str, Any]:
    """Steers one device, or wire and catheter, to the target."""
    environment = NavigateEnv(
        phantom,
        TARGET,
        wire=load_guidewire("default").scaled(WIRE_LENGTH),
        catheter=None if device == WIRE else device,
        observation="tip",
        max_steps=MOST_STEPS,
    )
    expert = SamplingExpert(environment, seed=seed, settings=TWO_DEVICES, threads=1)
    environment.reset(seed=0)
    began, forces, nearest, ended = time.process_time(), [], np.inf, False
    info: dict[str, Any] = {}
    while not ended:
        _, _, terminated, truncated, info = environment.step(expert.action())
        forces.append(info["force"])
        nearest = min(nearest, environment.task.remaining(phantom, info["tip"]))
        ended = terminated or truncated
    expert.close()
    return {
        "phantom": phantom.name,
        "device": device,
        "seed": seed,
        "success": bool(info["success"]),
        "steps": environment.steps,
        "nearest_mm": round(1e3 * nearest, 1),
        "force_mean_n": round(float(np.mean(forces)), 3),
        "force_max_n": round(max(forces), 3),
        "rollouts": expert.rollouts,
        "cpu_s": round(time.process_time() - began, 1),
    }


class Record:
    """Episodes in a file of one JSON object a line; those that it holds are not run again."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        rows = [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []
        self.rows = {(row["phantom"], row["device"], row["seed"]): row for row in rows}

    def episode(self, phantom: Phantom, device: str, seed: int) -> dict[str, Any]:
        """The episode, run if it is not there."""
        key = (phantom.name, device, seed)
        if key not in self.rows:
            row = self.rows[key] = episode(phantom, device, seed)
            print(json.dumps(row), flush=True)
            if self._path:
                with self._path.open("a") as lines:
                    lines.write(json.dumps(row) + "\n")
        return self.rows[key]


def main() -> None:
    """Finds the arches, runs the episodes, prints a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arches", type=int, default=20, help="in which the wire alone fails")
    parser.add_argument("--devices", default=f"{WIRE},simmons2", help="'wire' and names of the shelf of catheters")
    parser.add_argument("--searches", type=int, default=3, help="seeds of the search")
    parser.add_argument("--output", type=Path, help="file that episodes are added to, and taken from")
    arguments = parser.parse_args()
    devices, record = arguments.devices.split(","), Record(arguments.output)
    failing = (phantom for phantom in common_trunks() if not record.episode(phantom, WIRE, 0)["success"])
    arches = []
    for phantom in itertools.islice(failing, arguments.arches):
        arches.append(phantom)
        for device in devices:
            record.episode(phantom, device, 0)
    result = {}
    for device in devices:
        rows = [record.episode(phantom, device, seed) for seed in range(arguments.searches) for phantom in arches]
        reached = [row for row in rows if row["success"]]
        result[device] = {
            "success_pct": round(100 * len(reached) / len(rows), 1),
            "arches": len(arches),
            "episodes": len(rows),
            "steps_mean": round(float(np.mean([row["steps"] for row in reached])), 1) if reached else None,
            "force_max_n": max(row["force_max_n"] for row in rows),
        }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
