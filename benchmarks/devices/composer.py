"""The dm_control task with two devices beside the Gymnasium environment, and both beside finer steps.

    python benchmarks/devices/composer.py [--quick]

Nothing is random. Distance of the tips over 60 control steps, of the dm_control task (plain steps of 2.5 ms, none
repeated) from the environment with `accurate`; and over 60 steps in which both devices of a Simmons 2 are pushed, of
`accurate` and of the dm_control task with several timesteps from the environment with `reference`. Prints tables and,
as its last line, one JSON object. --quick takes the vertebral alone.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cathsim import Accuracy, NavigateEnv, composer

Array = NDArray[np.float64]

CATHETERS = ("vertebral", "simmons2")
TIP = "feeder/guidewire/tip"
STEPS, WIRE_ALONE = 60, 26  # control steps; those in which the wire goes 52 mm ahead
MASS_SCALE = 10.0  # of plain steps
TIMESTEPS = (0.001, 0.0025, 0.005)  # s
MOTIONS: dict[str, Callable[[int], Sequence[float]]] = {
    "both forwards": lambda step: (1.0, 0.0, 1.0, 0.0),
    "wire 52 mm ahead, then both": lambda step: (1.0, 0.0, 1.0 if step >= WIRE_ALONE else 0.0, 0.0),
    "both forwards, both turned": lambda step: (1.0, 0.2, 1.0, 0.5),
}


def tips_of_task(catheter: str, motion: str, numerics: Accuracy = composer.STEPPING) -> Array:
    """The tip after each step of the dm_control task, m. Shape (STEPS, 3)."""
    environment = composer.load(seed=0, numerics=numerics, catheter=catheter, start_jitter=0.0)
    environment.reset()
    tips = [environment.step(np.array(MOTIONS[motion](step))).observation[TIP] for step in range(STEPS)]
    environment.close()
    return np.array(tips)


def tips_of_environment(catheter: str, motion: str, accuracy: str) -> Array:
    """The tip after each step of the Gymnasium environment, m. Shape (STEPS, 3)."""
    environment = NavigateEnv(catheter=catheter, accuracy=accuracy, observation="tip", start_jitter=0.0)
    environment.reset(seed=0)
    tips = [environment.step(np.array(MOTIONS[motion](step)))[0] for step in range(STEPS)]
    environment.close()
    return np.array(tips, np.float64)


def apart(one: Array, other: Array) -> dict[str, float]:
    """Largest and median distance of two tips, mm."""
    distances = 1e3 * np.linalg.norm(one - other, axis=1)
    return {"largest_mm": round(float(distances.max()), 2), "median_mm": round(float(np.median(distances)), 2)}


def main() -> None:
    """Compares the tips, prints tables and a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the vertebral alone, without finer steps")
    arguments = parser.parse_args()
    began, rows, finer = time.perf_counter(), [], []
    print(f"{'catheter':<12} {'motion':<28} {'largest, mm':>12} {'median, mm':>11}")
    for catheter in CATHETERS[:1] if arguments.quick else CATHETERS:
        for motion in MOTIONS:
            row = apart(tips_of_task(catheter, motion), tips_of_environment(catheter, motion, "accurate"))
            rows.append({"catheter": catheter, "motion": motion, **row})
            print(f"{catheter:<12} {motion:<28} {row['largest_mm']:12.2f} {row['median_mm']:11.2f}", flush=True)
    if not arguments.quick:
        catheter, motion = CATHETERS[-1], next(iter(MOTIONS))
        exact = tips_of_environment(catheter, motion, "reference")
        runs = {"accurate": tips_of_environment(catheter, motion, "accurate")}
        for timestep in TIMESTEPS:
            numerics = Accuracy(timestep=timestep, refinement=1, mass_scale=MASS_SCALE)
            runs[f"dm_control, {1e3 * timestep:g} ms"] = tips_of_task(catheter, motion, numerics)
        print(f"\n{catheter}, {motion}, from `reference`")
        for name, tips in runs.items():
            finer.append({"steps": name, **apart(tips, exact)})
            print(f"{name:<24} {finer[-1]['largest_mm']:12.2f} {finer[-1]['median_mm']:11.2f}", flush=True)
    print(json.dumps({"tasks": rows, "from_reference": finer, "seconds": round(time.perf_counter() - began, 1)}))


if __name__ == "__main__":
    main()
