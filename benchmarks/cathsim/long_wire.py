"""Speed of a 600 mm wire of which 100 mm are inserted, beside that of the default wire, and cost against insertion.

    python benchmarks/cathsim/long_wire.py [--quick]

Prints tables and, as its last line, one JSON object:
    speed_ratio             steps/s of the long wire over the default's, internal observation: the median over rounds in
                            which both take turns, about 100 mm of insertion, at full speed to and fro with random
                            rotation
    tip_ratio, image_ratio  the same with the smallest observation, and with image and mask
    record_ratio            the same while every step is logged as an episode, pictures included
    long, default           median steps/s, internal observation
    links, active_links     of the long wire; those that are simulated at 100 mm
    log_bytes_ratio         size of the long wire's log over the default's
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections import defaultdict
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv, load_guidewire
from cathsim.environment import TRANSLATION_STEP
from pipeline.recording.record import record_episode

LENGTH, INSERTION = 0.6, 0.1  # m
BIN = 0.02  # of the table of cost against insertion, m
OBSERVATIONS: dict[str, str | tuple[str, ...]] = {"tip": "tip", "internal": "internal", "image": ("image", "mask")}


def to_and_fro(steps: int, seed: int) -> np.ndarray:
    """Actions that go 20 mm in and 20 mm out at full speed, turning at random. Shape (steps, 2)."""
    actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, 2))
    actions[:, 0] = np.where(np.arange(steps) // 10 % 2, -1.0, 1.0)
    return actions


def inserted(environment: NavigateEnv, seed: int) -> None:
    """Starts an episode and feeds the wire in to 90 mm, as a user would."""
    environment.reset(seed=seed)
    while environment.simulation.insertion < INSERTION - 0.01:
        environment.step(np.array([1.0, 0.0]))


def rate(environment: NavigateEnv, steps: int, seed: int) -> float:
    """Agent steps/s between 90 and 110 mm of insertion."""
    inserted(environment, seed)
    actions = to_and_fro(steps, seed)
    start = time.process_time()
    for action in actions:
        environment.step(action)
    return steps / (time.process_time() - start)


def recording_rate(environment: NavigateEnv, steps: int, seed: int, path: Path) -> float:
    """Agent steps/s while the episode is logged; from zero insertion, 100 mm in and then to and fro."""
    actions = np.concatenate((np.tile([1.0, 0.0], (50, 1)), to_and_fro(steps - 50, seed)))
    iterator = iter(actions)
    start = time.process_time()
    record_episode(environment, lambda observation, info: next(iterator), path, seed=seed, operator="benchmark")
    return steps / (time.process_time() - start)


def make(observation: str | tuple[str, ...], length: float | None, steps: int) -> NavigateEnv:
    """An environment whose episodes do not end early; length in m, None for the default wire."""
    wire = load_guidewire("default")
    return NavigateEnv(
        wire=wire.scaled(length) if length else wire, observation=observation, max_steps=steps, success_radius=1e-6
    )


def ratios(rounds: int, steps: int) -> dict[str, float]:
    """Medians of the ratios of both wires' rates, for several observations and while logging."""
    result: dict[str, float] = {}
    print(f"{'100 mm inserted':18s}{'default, steps/s':>18s}{'600 mm, steps/s':>18s}{'ratio':>8s}")
    for name, observation in OBSERVATIONS.items():
        pair = [make(observation, length, steps + 100) for length in (None, LENGTH)]
        for environment in pair:
            rate(environment, 40, 0)
        rows = []
        for index in range(rounds):  # whoever comes first changes from round to round
            order = pair if index % 2 == 0 else pair[::-1]
            rates = {id(environment): rate(environment, steps, index) for environment in order}
            rows.append([rates[id(environment)] for environment in pair])
        default, long = (statistics.median(row[k] for row in rows) for k in (0, 1))
        ratio = statistics.median(row[1] / row[0] for row in rows)
        result["speed_ratio" if name == "internal" else f"{name}_ratio"] = ratio
        print(f"{name:18s}{default:18.0f}{long:18.0f}{ratio:8.3f}")
        if name == "internal":
            simulation = pair[1].simulation
            result |= {"default": default, "long": long, "links": len(simulation.wire.links)}
            result["active_links"] = simulation.active_links

    with tempfile.TemporaryDirectory() as folder:
        pair = [make("tip", length, 200) for length in (None, LENGTH)]
        logs = [Path(folder) / f"{k}.mcap" for k in (0, 1)]
        rows = [
            [recording_rate(environment, 200, index, log) for environment, log in zip(pair, logs, strict=True)]
            for index in range(max(rounds // 2, 3))
        ]
        default, long = (statistics.median(row[k] for row in rows) for k in (0, 1))
        result["record_ratio"] = statistics.median(row[1] / row[0] for row in rows)
        result["log_bytes_ratio"] = logs[1].stat().st_size / logs[0].stat().st_size
    print(f"{'tip, logged':18s}{default:18.0f}{long:18.0f}{result['record_ratio']:8.3f}")
    print(f"the log is {result['log_bytes_ratio']:.2f} times as large\n")
    return result


def cost_against_insertion(runs: int) -> None:
    """Prints how long a step takes for both wires as they are fed in, by insertion."""
    pair = [make("tip", length, 400) for length in (None, LENGTH)]
    taken: dict[int, list[list[float]]] = defaultdict(lambda: [[], []])
    active: dict[int, list[int]] = {}
    for seed in range(-1, runs):  # the first run compiles the models
        for which, environment in enumerate(pair):
            generator = np.random.default_rng(max(seed, 0))
            environment.reset(seed=max(seed, 0))
            simulation = environment.simulation
            reach = pair[0].simulation.max_insertion - TRANSLATION_STEP
            for _ in range(110):
                if simulation.insertion > reach:
                    break
                row = int(simulation.insertion // BIN)
                action = np.array([1.0, generator.uniform(-1.0, 1.0)])
                start = time.process_time()
                environment.step(action)
                if seed >= 0:
                    taken[row][which].append(time.process_time() - start)
                    active.setdefault(row, [0, 0])[which] = simulation.active_links
    print(f"{'insertion, mm':16s}{'links':>8s}{'default, ms':>14s}{'600 mm, ms':>14s}{'links':>8s}")
    for row in sorted(taken):
        default, long = (1e3 * statistics.median(times) if times else float("nan") for times in taken[row])
        first, last = row * BIN * 1e3, (row + 1) * BIN * 1e3
        print(f"{first:6.0f} - {last:<7.0f}{active[row][0]:8d}{default:14.3f}{long:14.3f}{active[row][1]:8d}")
    print()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer rounds, under 50 s")
    quick = parser.parse_args().quick
    cost_against_insertion(runs=4 if quick else 20)
    result = ratios(rounds=7 if quick else 21, steps=300 if quick else 600)
    print(json.dumps({name: round(value, 4) for name, value in result.items()}))


if __name__ == "__main__":
    main()
