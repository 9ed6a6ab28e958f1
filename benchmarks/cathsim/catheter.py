"""A wire in a catheter: stability under random motions, speed, forces of the expert.

    python benchmarks/cathsim/catheter.py [--quick] [--parts A,B] [--seeds N] [--first-seed N] [--steps N]
        [--wire NAME] [--catheters A,B]

Prints tables and, as its last line, one JSON object: penetration_p99_mm, the largest of the catheters' 99th percentiles
of the deepest penetration after each substep; nan, the number of runs that became invalid; speed_ratio, steps a second
of processor time with the vertebral catheter over those of the bare wire (`accurate`, in turns, median), both devices
fed together; speed_ahead_ratio, with the wire ahead; force_mean_n and force_sd_n, of the readings of a load cell under
the phantom (ATI Mini40, SI-20-1, low-pass of 2 Hz) over the steps of the sampling expert with the vertebral catheter in
Type I.
--wire and --catheters choose the devices of the random motions. --quick takes one seed, few steps and a small budget of
the search, below 60 s.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cathsim import NavigateEnv, load_guidewire, load_phantom
from cathsim.devices.choice import simulation_of
from cathsim.devices.shelf import SHAPES, load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
from cathsim.metrics.load_cell import MINI40, step_forces
from cathsim.physics_checks.unguided import steps_per_second
from cathsim.planning.plan_trials import TWO_DEVICES, ExpertSettings
from cathsim.planning.sampling import SamplingExpert
from cathsim.presets import ACCURACY
from cathsim.simulation import CONTROL_STEP

Array = NDArray[np.float64]

PHANTOM, CATHETER = "type_1", "vertebral"
SPEED_CATHETERS = (CATHETER, "simmons2")
TARGETS = ("bca", "lcca")
REAL_MEAN, REAL_SD = 0.40, 0.19  # N, measured by the thesis, a catheter steered by hand through a robot
BURST = (5, 40)  # control steps in which the mean motion stays
RESTART = 500  # control steps after which a run begins again in the sheath
SPREAD = 0.4  # of a motion about that mean, in shares of a full step
AHEAD = 0.5  # share of the wire's speed at which the catheter follows it
AHEAD_STEPS = 240
PARTS = ("stability", "speed", "forces")
QUICK_EXPERT = ExpertSettings(samples=8, elites=3, rounds=1, primitives=True)
ROUNDS, QUICK_ROUNDS = 9, 3
SPEED_STEPS = 300
DEEPEST = 0.5  # mm, the aim


def random_motions(steps: int, generator: np.random.Generator) -> Array:
    """Motions of both feeders in bursts, in shares of a full step, shape (steps, 4): more forwards than back."""
    rows: list[Array] = []
    while len(rows) < steps:
        mean = generator.uniform((-0.6, -1, -0.6, -1), 1)
        rows += list(mean + SPREAD * generator.standard_normal((int(generator.integers(*BURST)), 4)))
    return np.clip(np.array(rows[:steps]), -1, 1)


def depths(wire: str, catheter: str, steps: int, seed: int) -> tuple[Array, bool]:
    """Deepest penetration (mm) after each substep of a run with random motions, and whether it stayed valid."""
    numerics = ACCURACY["accurate"]
    simulation = simulation_of(
        load_phantom(PHANTOM), load_guidewire(wire), load_catheter(catheter), numerics, measure_penetration=True
    )
    assert isinstance(simulation, DualSimulation)
    found = []
    motions = random_motions(steps, np.random.default_rng(seed)) * np.tile((TRANSLATION_STEP, ROTATION_STEP), 2)
    for step, motion in enumerate(motions):
        if step % RESTART == 0:
            simulation.reset()
        simulation.advance(motion[0], motion[1], catheter=(motion[2], motion[3]))
        found.append(simulation.depths.copy())
        if not simulation.valid:
            break
    return 1e3 * np.concatenate(found), simulation.valid


def stability(steps: int, seeds: range, wire: str, catheters: Sequence[str]) -> dict[str, float]:
    """Random motions with each catheter over a wire."""
    print(f"\n{'catheter':<12} {'runs x steps':>14} {'p99, mm':>8} {'max, mm':>8} {'invalid':>8}")
    largest, broken = 0.0, 0
    for catheter in catheters:
        runs = [depths(wire, catheter, steps, seed) for seed in seeds]
        all_depths, invalid = np.concatenate([run[0] for run in runs]), sum(not run[1] for run in runs)
        p99 = float(np.percentile(all_depths, 99))
        largest, broken = max(largest, p99), broken + invalid
        print(
            f"{catheter:<12} {f'{len(seeds)} x {steps}':>14} {p99:8.3f} {all_depths.max():8.3f} {invalid:8d}",
            flush=True,
        )
    print(f"aim: no invalid run, p99 below {DEEPEST} mm")
    return {"penetration_p99_mm": largest, "nan": broken}


def ahead_per_second(environment: NavigateEnv, seed: int) -> float:
    """Steps a second of processor time, the wire fed at full speed, a catheter at `AHEAD` of it; resets count."""
    forwards = np.array((1.0, 0.0, AHEAD, 0.0)[: environment.feeders.shape[0]])
    environment.reset(seed=seed)
    begin = time.process_time()
    for step in range(AHEAD_STEPS):
        if step % (AHEAD_STEPS // 2) == 0:
            environment.reset(seed=seed)
        environment.step(forwards)
    return AHEAD_STEPS / max(time.process_time() - begin, 1e-9)


def speeds(rounds: int, presets: tuple[str, ...]) -> dict[str, float]:
    """Speeds of the bare wire and with catheters in turns: fed together, half of it at random; and the wire ahead."""
    ratios: dict[tuple[str, str, str], float] = {}
    print(f"\n{'motion':<9} {'preset':<10} {'catheter':<12} {'steps/s':>8} {'over bare':>10} {'least':>6} {'most':>6}")
    for preset in presets:
        environments = {
            name: NavigateEnv(PHANTOM, catheter=name, accuracy=preset, observation="tip", success_radius=1e-6)
            for name in (None, *SPEED_CATHETERS)
        }
        motions = {
            "together": lambda one, turn: steps_per_second(one, SPEED_STEPS, seed=turn),
            "ahead": ahead_per_second,
        }
        for motion, rate_of in motions.items():
            rates = np.array([[rate_of(one, turn) for one in environments.values()] for turn in range(rounds)])
            for name, rate in zip(environments, rates.T, strict=True):
                ratio = rate / rates[:, 0]
                ratios[motion, preset, str(name)] = float(np.median(ratio))
                figures = f"{np.median(rate):8.0f} {np.median(ratio):10.2f} {ratio.min():6.2f} {ratio.max():6.2f}"
                print(f"{motion:<9} {preset:<10} {name or '-':<12} {figures}", flush=True)
    return {
        "speed_ratio": ratios["together", "accurate", CATHETER],
        "speed_ahead_ratio": ratios["ahead", "accurate", CATHETER],
    }


def expert_readings(target: str, seed: int, settings: ExpertSettings) -> tuple[Array, Array, bool]:
    """Readings of the load cell and sums of the contacts' magnitudes, N, (steps,) each; whether it was reached."""
    environment = NavigateEnv(PHANTOM, target, catheter=CATHETER, observation="tip")
    environment.reset(seed=seed)
    expert = SamplingExpert(environment, settings=settings, seed=seed)
    forces, ended = [], False
    while not ended:
        _, _, success, truncated, _ = environment.step(expert.action())
        forces.append(step_forces(environment.simulation))
        ended = success or truncated
    expert.close()
    loads = np.array([one.load for one in forces])
    readings = MINI40["SI-20-1"].read(loads, interval=CONTROL_STEP, generator=np.random.default_rng(seed))
    return np.linalg.norm(readings, axis=1), np.array([one.magnitude_sum for one in forces]), success


def expert_forces(targets: tuple[str, ...], seeds: int, settings: ExpertSettings) -> dict[str, float]:
    """Forces of the sampling expert, beside those measured on a phantom."""
    print(f"\n{'expert, target':<16} {'seed':>4} {'steps':>6} {'reached':>8} {'load cell, N':>16} {'sum, N':>16}")
    everything = []
    for target in targets:
        for seed in range(seeds):
            readings, sums, success = expert_readings(target, seed, settings)
            everything.append(readings)
            figures = f"{readings.mean():7.3f} +- {readings.std():5.3f} {sums.mean():7.3f} +- {sums.std():5.3f}"
            print(f"{target:<16} {seed:4d} {len(readings):6d} {success!s:>8} {figures}", flush=True)
    together = np.concatenate(everything)
    print(f"together {together.mean():.3f} +- {together.std():.3f} N; measured {REAL_MEAN:.2f} +- {REAL_SD:.2f} N")
    return {"force_mean_n": float(together.mean()), "force_sd_n": float(together.std())}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one seed, few steps, a small search: below 60 s")
    parser.add_argument("--parts", default=",".join(PARTS), help="what is measured, with commas between")
    parser.add_argument("--seeds", type=int, default=3, help="of the expert; random motions take one more")
    parser.add_argument("--first-seed", type=int, help="of random motions, which then take as many as --seeds")
    parser.add_argument("--steps", type=int, default=20_000, help="of a run with random motions")
    parser.add_argument("--wire", default="default", help="of random motions: a preset")
    parser.add_argument("--catheters", default=",".join(SHAPES), help="of random motions, with commas between")
    arguments = parser.parse_args()
    quick, begin, parts = arguments.quick, time.perf_counter(), arguments.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"unknown parts {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    try:
        load_guidewire(arguments.wire)
        for name in arguments.catheters.split(","):
            load_catheter(name)
    except ValueError as error:
        parser.error(str(error))
    motions = range(arguments.seeds + 1)
    if arguments.first_seed is not None:
        motions = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    figures: dict[str, float] = {}
    if "stability" in parts:
        steps, seeds = (300, range(1)) if quick else (arguments.steps, motions)
        figures |= stability(steps, seeds, arguments.wire, arguments.catheters.split(","))
    if "speed" in parts:
        figures |= speeds(QUICK_ROUNDS if quick else ROUNDS, ("accurate",) if quick else ("accurate", "fast"))
    if "forces" in parts:
        targets, searches = (TARGETS[:1], 1) if quick else (TARGETS, arguments.seeds)
        figures |= expert_forces(targets, searches, QUICK_EXPERT if quick else TWO_DEVICES)
    rounded = {name: round(value, 4) for name, value in figures.items()}
    print(json.dumps(rounded | {"wall_s": round(time.perf_counter() - begin, 1)}))


if __name__ == "__main__":
    main()
