"""What the stiffness of the wall changes, and how exactly a contact has the stiffness that was asked for.

    python benchmarks/forces/wall.py [--quick] [--seeds N]

The sampling expert's motions (wire alone, friction 0.06, all targets) are fed again into walls of other stiffness with
steps of 1 ms: mean forces and their ratios to the usual wall's, with 95 % intervals (bootstrap over episodes). Normal
force over depth of the contacts over the stiffness asked for, at rest and while the device is fed: median, 5th and 95th
percentile. Prints tables and, as its last line, one JSON object. --quick takes one seed and fewer stiffnesses.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from benchmarks.forces.episodes import USUAL_FRICTION, WIRE, Case, Episode, expert_episodes
from cathsim import ACCURACY
from cathsim.contact.compliance import stiffest_wall
from cathsim.metrics.load_cell import step_forces

Array = NDArray[np.float64]

WALLS = (None, 1.0, 2.0, 5.0, 10.0)  # N/mm
STIFFNESSES = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # N/mm
CATHETER = "vertebral"
RESAMPLES = 2000
PUSHES, READ, REST = 100, 30, 40  # control steps
TURNING = 0.57  # standard deviation of the turns, shares of a full step
LEAST_FORCE = 1e-3  # N


def replay(episode: Episode, wall: float | None) -> dict[str, Array]:
    """Feeds an episode's motions into a wall of another stiffness with steps of 1 ms; load and sum of each step, N."""
    environment = episode.case.environment(accuracy="reference", wall_stiffness=wall)
    environment.reset(seed=episode.case.seed)
    loads, sums = [], []
    for motion in episode.motions:
        environment.feeders.advance(environment.feeders.checked(motion))
        forces = step_forces(environment.simulation)
        loads.append(float(np.linalg.norm(forces.load)))
        sums.append(forces.magnitude_sum)
    return {"load": np.array(loads), "sum": np.array(sums)}


def replay_rows(episodes: Sequence[Episode], walls: Sequence[float | None]) -> list[dict[str, Any]]:
    """Mean forces of replays by the wall's stiffness, and the ratio to the usual wall's with its interval."""
    rows: list[dict[str, Any]] = []
    generator = np.random.default_rng(0)
    base: dict[str, Array] = {}
    drawn = generator.integers(len(episodes), size=(RESAMPLES, len(episodes)))
    for wall in walls:
        runs = [replay(episode, wall) for episode in episodes]
        row: dict[str, Any] = {"wall_n_per_mm": wall, "episodes": len(runs)}
        for name in ("load", "sum"):
            means = np.array([run[name].mean() for run in runs])
            base.setdefault(name, means)
            ratios = means[drawn].mean(1) / base[name][drawn].mean(1)
            row[name] = {"mean": float(means.mean()), "ratio": float(means.mean() / base[name].mean())}
            row[name]["ratio_interval"] = np.percentile(ratios, [2.5, 97.5]).tolist()
        rows.append(row)
    return rows


def stiffness_errors(device: str, accuracy: str, stiffness: float, seeds: int) -> list[dict[str, Any]]:
    """Normal force over depth over the stiffness that was asked for (N/mm), while the device is fed, and at rest.

    A device is fed 200 mm with random turns in `PUSHES` steps, contacts being read after each of the last `READ`; then
    it is held for `REST` steps, after which they are read once.
    """
    case = Case(device, USUAL_FRICTION, "push", "bca", 0)
    environment = case.environment(accuracy=accuracy, wall_stiffness=stiffness)
    simulation, feeders = environment.simulation, environment.feeders
    wall = simulation.model.geom("vessel").id
    ratios: dict[str, list[float]] = {"fed": [], "at rest": []}

    def read(when: str) -> None:
        data = simulation.data
        for contact in data.contact:
            if contact.geom[1] == wall and contact.efc_address >= 0:
                force = float(data.efc_force[contact.efc_address])
                if force > LEAST_FORCE:
                    ratios[when].append(force / -contact.dist / 1000.0 / stiffness)

    for seed in range(seeds):
        generator = np.random.default_rng(seed)
        simulation.reset(rotation=generator.uniform(-np.pi, np.pi))
        for step in range(PUSHES):
            turns = TURNING * generator.standard_normal(feeders.devices)
            feeders.advance(np.column_stack((np.ones(feeders.devices), turns)).ravel())
            if step >= PUSHES - READ:
                read("fed")
        for _ in range(REST):
            feeders.advance(np.zeros(feeders.shape))
        read("at rest")
    rows = []
    for when, found in ratios.items():
        low, median, high = np.percentile(found, [5, 50, 95]).tolist()
        row = {"device": device, "accuracy": accuracy, "when": when, "asked_n_per_mm": stiffness, "median": median}
        rows.append(row | {"p5": low, "p95": high, "contacts": len(found)})
    return rows


def main() -> None:
    """Replays the episodes, measures the stiffness, prints tables and a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one seed, two stiffnesses")
    parser.add_argument("--seeds", type=int, default=3, help="episodes to each target; pushes are twice as many")
    arguments = parser.parse_args()
    began, seeds = time.perf_counter(), 1 if arguments.quick else arguments.seeds
    replays = replay_rows(expert_episodes(WIRE, seeds), WALLS[:2] if arguments.quick else WALLS)
    print(f"{'wall, N/mm':<12} {'load, N':>8} {'ratio, load and sum':>24}")
    for row in replays:
        texts = [
            f"{row[name]['ratio']:.3f} {np.round(row[name]['ratio_interval'], 3)!s:>14}" for name in ("load", "sum")
        ]
        print(f"{row['wall_n_per_mm'] or 'usual'!s:<12} {row['load']['mean']:8.4f} {' '.join(texts)}")
    cases = [(WIRE, name) for name in ACCURACY] + [(CATHETER, "accurate")]
    stiffness = []
    for device, accuracy in cases:
        for asked in STIFFNESSES[: 2 if arguments.quick else None]:
            if asked <= stiffest_wall(ACCURACY[accuracy]) * 1.001:
                stiffness += stiffness_errors(device, accuracy, asked, 1 if arguments.quick else 2 * seeds)
    print(f"\n{'device':<10} {'accuracy':<10} {'':<8} {'N/mm':>5} {'median':>7} {'5 %':>7} {'95 %':>7} contacts")
    for row in stiffness:
        place = f"{row['device']:<10} {row['accuracy']:<10} {row['when']:<8} {row['asked_n_per_mm']:5.1f}"
        print(f"{place} {row['median']:7.3f} {row['p5']:7.3f} {row['p95']:7.3f} {row['contacts']}")
    seconds = round(time.perf_counter() - began, 1)
    print(json.dumps({"replays": replays, "stiffness": stiffness, "seconds": seconds}))


if __name__ == "__main__":
    main()
