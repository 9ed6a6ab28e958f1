"""Whether a still catheter stays where it is while the wire moves in it, and whether both come back into the sheath.

    python benchmarks/devices/withdrawal.py [--quick] [--catheters A,B] [--phantom NAME]

Type I, preset `accurate`, nothing random: both devices are fed 20, 50, 80 and 120 mm far, the wire 80 mm further and
back, then both are drawn back until nothing of them should be left. Prints, for each catheter, how far the still one
was off its place at most, the largest force of a feeder, and what stayed outside of the sheath, each over the four
depths, and as its last line one JSON object. --quick takes one catheter.
"""

from __future__ import annotations

import argparse
import json
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import CATHETERS, NavigateEnv
from cathsim.devices.shelf import SHAPES
from cathsim.devices.simulation import DualSimulation

DEPTHS = (10, 25, 40, 60)  # control steps of 2 mm
AHEAD, FURTHER_BACK = 40, 20


def withdrawn(phantom: str, catheter: str, depth: int) -> tuple[float, float, float]:
    """Largest displacement of the still catheter (mm), largest feeder force (N), and what is left outside (mm)."""
    environment = NavigateEnv(
        phantom, "lcca", catheter=catheter, observation="tip", success_radius=1e-6, accuracy="accurate"
    )
    environment.reset(seed=0)
    simulation = environment.simulation
    assert isinstance(simulation, DualSimulation)
    displacement = force = 0.0
    parts = (
        (depth, 0.002, 0.002),
        (2, 0.0, 0.0),
        (AHEAD, 0.002, 0.0),
        (AHEAD, -0.002, 0.0),
        (depth + FURTHER_BACK, -0.002, -0.002),
    )
    for part, (steps, wire, catheter_moves) in enumerate(parts):
        place = simulation.device_insertions()[1]
        for _ in range(steps):
            simulation.advance(wire, 0.0, catheter=(catheter_moves, 0.0))
            if part > 1:
                force = max(force, float(np.abs(simulation.feeder_forces()).max()))
            if part in (2, 3):
                displacement = max(displacement, abs(simulation.device_insertions()[1] - place))
    return 1e3 * displacement, force, 1e3 * max(simulation.device_insertions())


def main() -> None:
    """Moves the devices, prints a table and a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one catheter")
    parser.add_argument("--catheters", default=",".join(SHAPES), help="presets, with commas between")
    parser.add_argument("--phantom", default="type_1", help="preset, or random_7 and the like")
    arguments = parser.parse_args()
    names = ["jb2"] if arguments.quick else arguments.catheters.split(",")
    for name in names:
        if name not in CATHETERS:
            parser.error(f"unknown catheter {name!r}: choose from {', '.join(CATHETERS)}")
    began, result = time.perf_counter(), {}
    print(f"{'catheter':<12} {'off its place, mm':>18} {'feeder, N':>10} {'left outside, mm':>17}")
    for name in names:
        rows = np.array([withdrawn(arguments.phantom, name, depth) for depth in DEPTHS]).max(axis=0)
        result[name] = dict(zip(("displaced_mm", "feeder_n", "left_mm"), np.round(rows, 2).tolist(), strict=True))
        print(f"{name:<12} {rows[0]:18.1f} {rows[1]:10.1f} {rows[2]:17.1f}", flush=True)
    print(json.dumps({"phantom": arguments.phantom, **result, "seconds": round(time.perf_counter() - began, 1)}))


if __name__ == "__main__":
    main()
