"""A policy in ArchVariety: arches of six branching types that it has never seen, to random points.

    python benchmarks/enn/arch_variety.py --policy FILE [--arches 20] [--draw]

One episode in each of so many arches of the test seeds a type, of which nothing was trained or chosen on; episode k of
a type begins with seed k, as the sampling expert's in `benchmarks/cathsim/arch_variety.py` do. Prints a row a type with
Wilson's 95 % interval, which branches were missed, and one JSON object as its last line.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import enn
from cathsim.anatomy.generator.variety.branching_types import ARCH_TYPES
from cathsim.arch_variety.environment import TEST_SEEDS, ArchVarietyEnv
from cathsim.arch_variety.task import TEST_STEPS
from cathsim.metrics.intervals import wilson_interval
from cathsim.observations.xray import XrayEnvironment
from enn.policy import Policy
from enn.shipped import read_policy
from pipeline.task import task_in_random_arches


@dataclass(frozen=True)
class Outcome:
    """How an episode went."""

    success: bool
    branch: str  # that its target lies in
    forces: np.ndarray  # of each step, N


def arguments() -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="generalist", help=f"a file, or among {', '.join(enn.models())}")
    parser.add_argument("--types", default=",".join(ARCH_TYPES))
    parser.add_argument("--arches", type=int, default=20, help="a type, one episode each")
    parser.add_argument("--max-steps", type=int, default=TEST_STEPS)
    parser.add_argument("--draw", action="store_true", help="actions are drawn; otherwise the best ones")
    return parser.parse_args()


def play(environment: Any, controller: Any, case: int, seed: int) -> Outcome:
    """Plays one episode."""
    observation, info = environment.reset(seed=seed, options={"case": case})
    controller.reset()
    forces: list[float] = []
    ended = success = False
    while not ended:
        observation, _, success, truncated, info = environment.step(controller(observation, info))
        forces.append(float(info["force"]))
        ended = success or truncated
    goal = environment.unwrapped.task.target
    return Outcome(bool(success), environment.unwrapped.phantom.target(goal).branch, np.array(forces))


def row_of(name: str, outcomes: list[Outcome], seconds: float) -> dict[str, Any]:
    """Prints a row, and returns it."""
    won = [one for one in outcomes if one.success]
    low, high = wilson_interval(len(won), len(outcomes))
    row = {
        "type": name, "reached": len(won), "episodes": len(outcomes),
        "interval_pct": [round(100 * low), round(100 * high)],
        "steps": round(float(np.mean([len(one.forces) for one in won])), 1) if won else None,
        "force_mean_n": round(float(np.mean([one.forces.mean() for one in outcomes])), 3),
        "force_max_n": round(max(float(one.forces.max()) for one in outcomes), 2),
        "force_max_median_n": round(float(np.median([one.forces.max() for one in outcomes])), 2),
        "cpu_s": round(seconds / len(outcomes), 2),
        "missed": dict(Counter(one.branch for one in outcomes if not one.success)),
    }  # fmt: skip
    share = f"{100 * len(won) / len(outcomes):3.0f} % ({100 * low:.0f} to {100 * high:.0f})"
    forces = ", ".join(f"{row[key]:.2f}" for key in ("force_mean_n", "force_max_n", "force_max_median_n"))
    missed = ", ".join(f"{count} {branch}" for branch, count in row["missed"].items())
    print(f"{name:5}{len(won)} of {len(outcomes)}  {share}  {row['steps']} steps  {forces} N  {missed}", flush=True)
    return row


def main() -> None:
    """Runs the command line."""
    given = arguments()
    try:
        policy = read_policy(Path(given.policy)) if given.policy.endswith(".pt") else enn.load(given.policy)
        by_roadmap, side = isinstance(policy, Policy), task_in_random_arches().image_size_px
        if given.draw and not by_roadmap:
            raise ValueError("--draw: a policy that sees images always takes the best action")
        seeds, kinds = TEST_SEEDS[: given.arches], given.types.split(",")
        keys = policy.keys if by_roadmap else ("goal_image",)
        bare = ArchVarietyEnv(kinds, seeds, observation=keys, max_steps=given.max_steps, image_size=side)
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    environment: Any = bare if by_roadmap else XrayEnvironment(bare, side)
    rows, together, began = [], [], time.process_time()
    for index, kind in enumerate(kinds):
        outcomes, start = [], time.process_time()
        for number in range(len(seeds)):
            drawn = {"deterministic": not given.draw, "seed": number} if by_roadmap else {}
            case = bare.case_of(index * len(seeds) + number)
            outcomes.append(play(environment, policy.controller(**drawn), case, number))
        rows.append(row_of(kind, outcomes, time.process_time() - start))
        together += outcomes
    rows.append(row_of("all", together, time.process_time() - began))
    print(json.dumps({"policy": given.policy, "drawn": given.draw, "rows": rows}))


if __name__ == "__main__":
    main()
