"""Whether a wire, or a wire in a catheter, can reach the targets of an anatomy at all: a search without a policy.

    python benchmarks/anatomy/reachable.py PATH|random_7 [--targets bca,lcca] [--catheter simmons2] [--seeds 1]
                                           [--steps 16000] [--draw FILE.png]

Searches random motions from states that were kept (`cathsim.planning.state_search`), from the wire laid 80 and 110 mm
before the target on, in time steps `fast`. What is reached can be reached; what is not was not found within the steps.
Prints a line a target and seed with how far its ostium is set back behind the top of the arch, and one JSON object as
its last line. --draw: the last target's states in three views.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv
from cathsim.planning.state_search import FoundStates, StateSearchSettings, search_states
from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.anatomies.settings import fitted_task
from pipeline.anatomies.take_offs import set_back_mm
from pipeline.task import task_in_random_arches

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

AROUND = 60.0  # mm, half the width of a view


def environment(phantom: Phantom, target: str, catheter: str | None) -> NavigateEnv:
    """The task of the shipped policies, its wire as long as the way asks for."""
    usual = task_in_random_arches()
    task = fitted_task(replace(usual, wire_length_mm=0.0), phantom, [target])
    task = replace(task, wire_length_mm=max(task.wire_length_mm, usual.wire_length_mm), catheter=catheter)
    return NavigateEnv(phantom, target=target, observation="tip", **task.devices(), **task.rules())


def draw(env: NavigateEnv, target: str, found: FoundStates, path: Path) -> None:
    """Draws the lumen around the ostium, centrelines, target and the devices in the states found, dark to bright."""
    import matplotlib.pyplot as plt

    phantom = env.phantom
    goal = phantom.target(target)
    centre = 1e3 * phantom.tree.ostium(phantom.tree.ancestry(goal.branch)[1])
    wall = 1e3 * np.asarray(phantom.lumen_mesh.vertices)[::3]
    near = wall[(np.abs(wall - centre) < AROUND).all(axis=1)]
    figure, axes = plt.subplots(1, 3, figsize=(15, 5.5), layout="constrained")
    for axis, (across, up) in zip(axes, ((0, 2), (1, 2), (0, 1)), strict=True):
        axis.scatter(near[:, across], near[:, up], s=0.3, color="0.8")
        for branch in phantom.tree:
            axis.plot(1e3 * branch.points[:, across], 1e3 * branch.points[:, up], color="tab:red", linewidth=0.6)
        for number, state in enumerate(found.states):
            env.simulation.restore(state)
            points = 1e3 * env.simulation.inserted_points()
            axis.plot(points[:, across], points[:, up], color=plt.cm.viridis(number / len(found.states)), linewidth=1)
        axis.plot(1e3 * goal.position[across], 1e3 * goal.position[up], "m*", markersize=12)
        axis.set(
            xlim=centre[across] + np.array([-AROUND, AROUND]), ylim=centre[up] + np.array([-AROUND, AROUND]),
            aspect="equal", xlabel=f"{'xyz'[across]}, mm", ylabel=f"{'xyz'[up]}, mm",
        )  # fmt: skip
    figure.savefig(path, dpi=100)


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("anatomy", help="a file, a folder, or a name of the library")
    parser.add_argument("--targets", help="by default all of bca, lcca, lsa that there are")
    parser.add_argument("--catheter", help="over the wire, a preset's name; by default the wire alone")
    parser.add_argument("--seeds", type=int, default=1, help="of the search, from 1 on, until one reaches the target")
    parser.add_argument("--steps", type=int, default=16_000, help="of a search at most")
    parser.add_argument("--draw", type=Path, help="picture of the last target's states")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    try:
        phantom = load_anatomy(AnatomyFile(given.anatomy) if Path(given.anatomy).exists() else given.anatomy)
        usual = [name for name in ("bca", "lcca", "lsa") if name in phantom.targets]
        targets = given.targets.split(",") if given.targets else usual
        settings = StateSearchSettings(steps=given.steps)
        for target in targets:
            env = environment(phantom, target, given.catheter)
            back = set_back_mm(phantom, target)
            for seed in range(1, given.seeds + 1):
                begun = time.process_time()
                found = search_states(env, np.random.default_rng(seed), settings=settings)
                rows.append({
                    "target": target, "device": given.catheter or "wire", "seed": seed, "reached": found.reached,
                    "nearest_mm": round(1e3 * found.nearest, 1), "set_back_mm": round(back, 1), "steps": found.steps,
                    "cpu_s": round(time.process_time() - begun, 1),
                })  # fmt: skip
                print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
                if found.reached:
                    break
            if given.draw and target == targets[-1]:
                draw(env, target, found, given.draw)
            env.close()
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    print(json.dumps({"anatomy": phantom.name, "rows": rows}))


if __name__ == "__main__":
    main()
