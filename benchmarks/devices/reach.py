"""Arches with a common trunk in which a wire alone, and one in a catheter, reaches the LCCA with one budget.

    python benchmarks/devices/reach.py [--arches N] [--devices wire,simmons2] [--searches N] [--seeds 33006,33009]
                                       [--search patient|direct] [--steps N] [--attempts N] [--output FILE.jsonl]

Random arches with a common origin of BCA and LCCA, from seed 33000 on, target LCCA. An arch counts when the wire alone
fails to be steered there by the direct search, with seed 0: at most 300 steps, no way out of local minima. Then every
device, the wire alone among them, is steered there with each search seed, by the patient search unless the direct one
is asked for: the expert's usual settings for two devices, at most 600 steps. Each episode has a process of its own;
those already in the output file are not run again. Prints a line an episode and, last, one JSON object: device to
success_pct, its Wilson interval, arches, episodes, steps_mean, force_max_n. With more attempts than one, devices that
have not arrived are drawn back to the start, and a search with another seed follows (search seed + 100 for the second);
an episode then succeeds in any of its attempts, and its steps and forces are those of all.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv, load_catheter, load_guidewire, load_phantom
from cathsim.anatomy.generator.recipe import draw_recipe
from cathsim.metrics.intervals import wilson_interval
from cathsim.planning.expert_settings import TWO_DEVICES
from cathsim.planning.sampling import SamplingExpert

TARGET, WIRE_LENGTH = "lcca", 0.36
FIRST_SEED = 33_000
NEXT_SEED = 100  # between the search seeds of an episode's attempts
WIRE, PATIENT = "wire", "patient"  # the device without a catheter; the search that compares devices
# Search to settings and most steps: the one by which arches are chosen, and the one that is compared.
SEARCHES = {
    "direct": (dataclasses.replace(TWO_DEVICES, confirm=0, patience=0), 300),
    PATIENT: (TWO_DEVICES, 600),
}


def common_trunks() -> Iterator[int]:
    """Seeds of the random arches with a common trunk, one after the other."""
    return (seed for seed in itertools.count(FIRST_SEED) if getattr(draw_recipe("random", seed), "bovine", False))


def episode(arch: int, device: str, seed: int, search: str, most_steps: int) -> dict[str, Any]:
    """Steers one device, or wire and catheter, to the target."""
    settings, _ = SEARCHES[search]
    phantom = load_phantom("random", seed=arch)
    environment = NavigateEnv(
        phantom,
        TARGET,
        wire=load_guidewire("default").scaled(WIRE_LENGTH),
        catheter=None if device == WIRE else device,
        observation="tip",
        max_steps=most_steps,
    )
    expert = SamplingExpert(environment, seed=seed, settings=settings, threads=1)
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
        "search": search,
        "most_steps": most_steps,
        "success": bool(info["success"]),
        "steps": environment.steps,
        "nearest_mm": round(1e3 * nearest, 1),
        "force_mean_n": round(float(np.mean(forces)), 3),
        "force_max_n": round(max(forces), 3),
        "rollouts": expert.rollouts,
        "escapes": expert.escapes,
        "cpu_s": round(time.process_time() - began, 1),
    }


class Record:
    """Episodes in a file of one JSON object a line; those that it holds are not run again."""

    def __init__(self, path: Path | None, steps: int | None) -> None:
        self._path, self._steps = path, steps
        rows = [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []
        self.rows = {}
        for row in rows:  # before --steps there was, none was named
            most_steps = row.get("most_steps", SEARCHES[row["search"]][1])
            self.rows[row["phantom"], row["device"], row["seed"], row["search"], most_steps] = row

    def episode(self, arch: int, device: str, seed: int, search: str) -> dict[str, Any]:
        """The episode, run in a new process if it is not there: arches and models of many would fill the memory."""
        most_steps = self._steps if self._steps and search == PATIENT else SEARCHES[search][1]
        key = (f"random_{arch}", device, seed, search, most_steps)
        if key not in self.rows:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                row = self.rows[key] = pool.submit(episode, arch, device, seed, search, most_steps).result()
            print(json.dumps(row), flush=True)
            if self._path:
                with self._path.open("a") as lines:
                    lines.write(json.dumps(row) + "\n")
        return self.rows[key]

    def attempts(self, arch: int, device: str, seed: int, search: str, most: int) -> dict[str, Any]:
        """The episode of attempts that follow each other until one succeeds."""
        tried: list[dict[str, Any]] = []
        while len(tried) < most and not (tried and tried[-1]["success"]):
            tried.append(self.episode(arch, device, seed + NEXT_SEED * len(tried), search))
        steps, force = sum(row["steps"] for row in tried), max(row["force_max_n"] for row in tried)
        return tried[-1] | {"steps": steps, "force_max_n": force}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of one device's episodes."""
    reached = [row for row in rows if row["success"]]
    low, high = wilson_interval(len(reached), len(rows))
    return {
        "success_pct": round(100 * len(reached) / len(rows), 1),
        "interval_pct": [round(100 * low, 1), round(100 * high, 1)],
        "arches": len({row["phantom"] for row in rows}),
        "episodes": len(rows),
        "steps_mean": round(float(np.mean([row["steps"] for row in reached])), 1) if reached else None,
        "force_max_n": max(row["force_max_n"] for row in rows),
    }


def main() -> None:
    """Finds the arches, runs the episodes, prints a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arches", type=int, default=20, help="in which the wire alone fails")
    parser.add_argument("--devices", default=f"{WIRE},simmons2", help="'wire' and names of the shelf of catheters")
    parser.add_argument("--searches", type=int, default=3, help="seeds of the search")
    parser.add_argument("--seeds", help="of these arches alone, whatever the wire does in them")
    parser.add_argument("--search", choices=SEARCHES, default=PATIENT, help="of the devices that are compared")
    parser.add_argument("--steps", type=int, help="at most, by the patient search; without it 600")
    parser.add_argument("--attempts", type=int, default=1, help="of an episode, each with another search seed")
    parser.add_argument("--output", type=Path, help="file that episodes are added to, and taken from")
    arguments = parser.parse_args()
    if arguments.attempts < 1:
        parser.error(f"--attempts must be at least 1, got {arguments.attempts}")
    try:
        for name in set(arguments.devices.split(",")) - {WIRE}:
            load_catheter(name)
    except ValueError as error:
        parser.error(str(error))
    record = Record(arguments.output, arguments.steps)
    failing = (arch for arch in common_trunks() if not record.episode(arch, WIRE, 0, "direct")["success"])
    chosen = [int(seed) for seed in arguments.seeds.split(",")] if arguments.seeds else failing
    arches = list(itertools.islice(chosen, arguments.arches))
    result = {}
    for device in arguments.devices.split(","):
        seeds = range(arguments.searches)
        rows = [
            record.attempts(arch, device, seed, arguments.search, arguments.attempts)
            for seed in seeds
            for arch in arches
        ]
        result[device] = summary(rows)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
