"""How substeps that end in the wall are repeated, with a catheter: speed, and nearness to `reference`.

    python benchmarks/devices/time_steps.py [--catheters vertebral,simmons2] [--seeds N] [--first-seed N] [--quick]

Plays the same random motions in Type I with every time stepping: both devices forwards at speeds, and with turns, that
are drawn anew every 15 steps. Prints a row a catheter, preset and number of repetitions: processor time over that of
`reference`, distance of the tips at the same step, mean and 99th percentile of the resultant contact force, the mean
difference of the forces at the same step, and the 99th percentile of the steps' deepest penetration; then one JSON
object.
--quick takes one seed and one catheter.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cathsim import load_guidewire, load_phantom
from cathsim.devices.choice import simulation_of
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
from cathsim.presets import ACCURACY, Accuracy

PHANTOM, CATHETERS, STEPS, HELD = "type_1", "vertebral,simmons2", 120, 15
SLOWEST, FASTEST = (0.3, -1.0, 0.2, -1.0), (1.0, 1.0, 0.9, 1.0)  # wire forwards, turned; catheter forwards, turned
REFERENCE = "reference"
# shorter substeps, and the depth in tolerances after which each is repeated in as many again
REPETITIONS = {
    "accurate": ((8, 2.0), (4, 2.0), (3, 2.0), (3, 1.5), (2, 1.5)),
    "fast": ((4, 2.0), (3, 2.0), (2, 2.0), (2, 1.5)),
}

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Course:
    """What was measured after every control step of all runs of one time stepping."""

    tips: Array  # (runs, steps, 3) m
    forces: Array  # (runs, steps) N
    depths: Array  # (runs, steps) m, the deepest after any substep
    seconds: float  # of the processor


def play(catheter: str, numerics: Accuracy, seeds: range) -> Course:
    """Plays the motions of each seed."""
    simulation = simulation_of(
        load_phantom(PHANTOM), load_guidewire("default"), load_catheter(catheter), numerics, measure_penetration=True
    )
    assert isinstance(simulation, DualSimulation)
    shape = (len(seeds), STEPS)
    tips, forces, depths = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape)
    began = time.process_time()
    for run, seed in enumerate(seeds):
        generator = np.random.default_rng(seed)
        simulation.reset()
        for step in range(STEPS):
            if step % HELD == 0:
                motion = generator.uniform(SLOWEST, FASTEST) * np.tile((TRANSLATION_STEP, ROTATION_STEP), 2)
            simulation.advance(motion[0], motion[1], catheter=(motion[2], motion[3]))
            tips[run, step], depths[run, step] = simulation.tip, simulation.depths.max()
            forces[run, step] = np.linalg.norm(simulation.force())
    return Course(tips, forces, depths, time.process_time() - began)


def row(name: str, numerics: Accuracy, course: Course, reference: Course) -> dict[str, float | str]:
    """Figures of one time stepping beside the reference."""
    apart = 1e3 * np.linalg.norm(course.tips - reference.tips, axis=-1)
    figures = {
        "time_ratio": course.seconds / reference.seconds,
        "tip_median_mm": float(np.median(apart)),
        "tip_p90_mm": float(np.percentile(apart, 90)),
        "force_mean_n": float(course.forces.mean()),
        "force_p99_n": float(np.percentile(course.forces, 99)),
        "force_apart_n": float(np.abs(course.forces - reference.forces).mean()),
        "penetration_p99_mm": float(1e3 * np.percentile(course.depths, 99)),
    }
    stepped = numerics.with_catheter
    columns = " ".join(f"{value:10.3f}" for value in figures.values())
    print(f"{name:<10} {stepped.refinement:>8} {stepped.deep:>6g} {columns}", flush=True)
    settings: dict[str, float | str] = {"preset": name, "repeated_in": stepped.refinement, "deep": stepped.deep}
    return settings | {key: round(value, 4) for key, value in figures.items()}


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--catheters", default=CATHETERS, help="names of the shelf")
    parser.add_argument("--seeds", type=int, default=10, help="runs of each time stepping")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="one run, one catheter")
    given = parser.parse_args()
    catheters = given.catheters.split(",")[: 1 if given.quick else None]
    seeds = range(given.first_seed, given.first_seed + (1 if given.quick else given.seeds))
    try:
        for catheter in catheters:
            load_catheter(catheter)
    except ValueError as error:
        parser.error(str(error))
    found: dict[str, list[dict[str, float | str]]] = {}
    for catheter in catheters:
        columns = ("time", "tip mm", "p90", "force N", "p99", "apart", "depth mm")
        print(f"{catheter:<10} {'repeated':>8} {'deep':>6} " + " ".join(f"{column:>10}" for column in columns))
        reference = play(catheter, ACCURACY[REFERENCE], seeds)
        found[catheter] = [row(REFERENCE, ACCURACY[REFERENCE], reference, reference)]
        for name, choices in REPETITIONS.items():
            for count, deep in choices:
                changed = dataclasses.replace(ACCURACY[name], catheter_refinement=count, catheter_deep=deep)
                found[catheter].append(row(name, changed, play(catheter, changed, seeds), reference))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
