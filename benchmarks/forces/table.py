"""What a load cell under the phantom reads, by device, friction, operator and target, beside a measured distribution.

    python benchmarks/forces/table.py [--quick] [--seeds N] [--frictions A,B] [--devices A,B] [--policies A,B]
                                      [--blood steady|pulsatile] [--json FILE] [--png FILE]

Episodes in Type I to within 8 mm of the target, at most 300 steps; nothing is fitted. Of every control step: the
reading of the load cell (ATI Mini40, SI-20-1, low-pass of 2 Hz), the mean sum of the contacts' magnitudes, and the
largest single contact. Devices: "wire", or a catheter of `cathsim.devices` over that wire. Operators: "expert", the
sampling expert with the same settings for every device; "random"; "push_and_turn", scripted motions without a target;
"enn", a policy of that stage, deterministic, and "policy", one by a roadmap, its actions drawn: those of --policies,
each with the devices, and towards the target, that it was trained with.
Intervals: 95 %, bootstrap over episodes. Prints tables and, as its last line, one JSON object. --quick takes one seed,
friction and target, and of the catheters the vertebral.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from benchmarks.forces.episodes import TARGETS, USUAL_FRICTION, WIRE, Case, Episode, run_episode
from benchmarks.forces.operators import OPERATORS, TrainedOperator
from benchmarks.forces.picture import QUANTITIES, REAL_MEAN, REAL_SD, draw
from cathsim import load_catheter
from cathsim.blood.flow import FLOWS

Array = NDArray[np.float64]
Combination = tuple[str, float, str, int]  # device, friction, target, seed

FRICTIONS = (0.03, 0.06, 0.1, 0.2)
DEVICES = (WIRE, "vertebral", "simmons2")
LAST_STEPS = 30
RESAMPLES = 2000
TABLES = {
    "by_operator": ("device", "operator"),
    "by_friction": ("device", "operator", "friction"),
    "by_target": ("device", "operator", "target"),
    "all": ("device", "friction", "operator", "target"),
}


def moments(samples: Sequence[Array], generator: np.random.Generator) -> dict[str, Any]:
    """Mean and SD over the steps of all episodes, with 95 % intervals over episodes; 5th, 50th, 95th percentile; N."""
    sizes = np.array([len(sample) for sample in samples])
    sums, squares = (np.array([(sample**power).sum() for sample in samples]) for power in (1, 2))
    drawn = generator.integers(len(samples), size=(RESAMPLES, len(samples)))
    n = sizes[drawn].sum(1)
    means = sums[drawn].sum(1) / n
    sds = np.sqrt(np.maximum(squares[drawn].sum(1) / n - means**2, 0.0))
    pooled = np.concatenate(samples)
    return {
        "mean": float(pooled.mean()),
        "sd": float(pooled.std()),
        "mean_interval": np.percentile(means, [2.5, 97.5]).tolist(),
        "sd_interval": np.percentile(sds, [2.5, 97.5]).tolist(),
        "percentiles": np.percentile(pooled, [5, 50, 95]).tolist(),
        "sd_of_episode_means": float(np.std([sample.mean() for sample in samples])),
    }


def summarise(episodes: Sequence[Episode], keys: Sequence[str]) -> list[dict[str, Any]]:
    """One row for every combination of the attributes `keys` that there are episodes of."""
    rows, generator = [], np.random.default_rng(0)
    groups = dict.fromkeys(tuple(getattr(one.case, key) for key in keys) for one in episodes)
    for group in groups:
        chosen = [one for one in episodes if tuple(getattr(one.case, key) for key in keys) == group]
        row: dict[str, Any] = dict(zip(keys, group, strict=True))
        row |= {
            "episodes": len(chosen),
            "steps": sum(len(one.sums) for one in chosen),
            "success_pct": 100.0 * float(np.mean([one.success for one in chosen])),
        }
        for name in QUANTITIES:
            row[name] = moments([one.quantities()[name] for one in chosen], generator)
        last = np.concatenate([one.reading("SI-20-1")[-LAST_STEPS:] for one in chosen])
        row["load_cell_last_30"] = {"mean": float(last.mean()), "sd": float(last.std())}
        reading = np.concatenate([one.reading("SI-20-1") for one in chosen])
        row["above_real_mean_pct"] = 100.0 * float(np.mean(reading > REAL_MEAN))
        rows.append(row)
    return rows


def print_rows(rows: Sequence[dict[str, Any]], keys: Sequence[str]) -> None:
    """Prints a table of `summarise`."""
    head = [*keys, "episodes", "steps", "success %", *QUANTITIES, "load cell, last 30", "above 0.40 N %"]
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in rows:
        cells = [str(row[key]) for key in keys] + [str(row["episodes"]), str(row["steps"]), f"{row['success_pct']:.0f}"]
        for name in QUANTITIES:
            one = row[name]
            low, high = one["mean_interval"]
            cells.append(f"{one['mean']:.3f} ± {one['sd']:.3f} [{low:.3f}, {high:.3f}]")
        cells.append(f"{row['load_cell_last_30']['mean']:.3f} ± {row['load_cell_last_30']['sd']:.3f}")
        print("| " + " | ".join([*cells, f"{row['above_real_mean_pct']:.1f}"]) + " |")


def untrained(combinations: Iterable[Combination], blood: str | None) -> Iterator[Episode]:
    """Episodes of all operators that need no training, by device, friction, target and seed."""
    for device, friction, target, seed in combinations:
        for name, operator in OPERATORS.items():
            yield run_episode(Case(device, friction, name, target, seed, blood), operator)


def of_policies(combinations: Iterable[Combination], sources: Sequence[str], blood: str | None) -> Iterator[Episode]:
    """Episodes of trained policies, each with the devices and towards the targets that it fits."""
    for operator in map(TrainedOperator, sources):
        for device, friction, target, seed in combinations:
            case = Case(device, friction, operator.name, target, seed, blood)
            if operator.fits(case):
                yield run_episode(case, operator, operator.observation)


def main() -> None:
    """Runs the episodes, prints tables and a JSON line, draws the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one seed, friction and target, wire and vertebral")
    parser.add_argument("--seeds", type=int, default=3, help="episodes of each combination")
    parser.add_argument("--frictions", help="coefficients, with commas between")
    parser.add_argument("--devices", help="wire, or presets of catheters, with commas between")
    parser.add_argument(
        "--policies", default="", help="files of trained ones or names of shipped ones, with commas between"
    )
    parser.add_argument("--blood", choices=tuple(FLOWS), help="a flow that drags the devices along")
    parser.add_argument("--json", type=Path, help="file for the JSON object")
    parser.add_argument("--png", type=Path, help="file for the figure")
    arguments = parser.parse_args()
    began, processor = time.perf_counter(), time.process_time()
    seeds = 1 if arguments.quick else arguments.seeds
    frictions, devices = ([USUAL_FRICTION], list(DEVICES[:2])) if arguments.quick else (list(FRICTIONS), list(DEVICES))
    if arguments.frictions:
        frictions = [float(friction) for friction in arguments.frictions.split(",")]
    if arguments.devices:
        devices = arguments.devices.split(",")
        try:
            for name in set(devices) - {WIRE}:
                load_catheter(name)
        except ValueError as error:
            parser.error(str(error))
    targets = TARGETS[: 1 if arguments.quick else None]
    combinations = list(itertools.product(devices, frictions, targets, range(seeds)))
    episodes = list(untrained(combinations, arguments.blood))
    if arguments.policies:
        episodes += of_policies(combinations, arguments.policies.split(","), arguments.blood)
    episodes.sort(key=lambda one: devices.index(one.case.device))
    result: dict[str, Any] = {"real": [REAL_MEAN, REAL_SD], "seeds": seeds, "blood": arguments.blood}
    for title, keys in TABLES.items():
        result[title] = summarise(episodes, keys)
        print(f"\n{title.replace('_', ' ')}, N, mean ± SD [interval of the mean]")
        print_rows(result[title], keys)
    if arguments.png:
        draw(episodes, arguments.png)
    result["seconds"] = round(time.perf_counter() - began, 1)
    result["processor_seconds"] = round(time.process_time() - processor, 1)
    text = json.dumps(result)
    if arguments.json:
        arguments.json.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
