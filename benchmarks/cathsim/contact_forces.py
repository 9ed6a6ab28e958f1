"""Contact forces from a wire's shape against the simulator's: errors and intervals by noise of the curve.

Truth is a wire at rest after random pushes and turns. The estimator gets its curve with noise that is smooth over
10 mm, and in the real case a wrong insertion (1 mm), rotation (0.2 rad), place of the lumen (0.5 mm an axis), radius of
the lumen (0.2 mm) and bending stiffness (10 %), all normal. With --pair a vertebral catheter lies over the wire; its
insertion and rotation are wrong by as much as the wire's. The last line is JSON.

    python benchmarks/cathsim/contact_forces.py [--quick] [--training | --pair] [--members 40] [--out results.json]
    python benchmarks/cathsim/contact_forces.py --arches 220 80 --noises 0.5 --seeds 1 --out calibration.json

The second command is for the calibration of the intervals: "widening" is the factor on `WIDENING` of
`cathsim.statics.ensemble_summary` with which 90 % of them would hold the truth.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom, load_phantom
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation
from cathsim.statics import (
    ContactForceEstimator,
    ContactForces,
    Estimate,
    Uncertainty,
    drawn_errors,
    inserted_curve,
    noisy_curve,
)
from cathsim.statics.ensemble_summary import RestingContacts, resting_contacts
from cathsim.statics.estimator import MEMBERS
from cathsim.statics.observed_curve import observed_curve

NAMED, NAMED_STATES = ("type_1", "type_2", "bovine"), 2
RANDOM, RANDOM_STATES = range(20), 1
PAIR_RANDOM = range(8)
TRAINING = range(200, 220)  # seeds of random arches for choices and calibration
NOISES_MM = (0.0, 0.25, 0.5, 1.0)
RECONSTRUCTED_MM = (
    0.5  # the noise of a reconstruction, at which there are more draws, and estimates without feeder data
)
SEEDS = 3  # of noise and errors at that noise; one at the others
QUANTITIES = ("resultant", "normal_sum", "largest")
RESAMPLES = 1000

Array = NDArray[np.float64]


Device = Guidewire | DevicePair

LEAST_RESULTANT = 0.03  # N: relative errors of less mean little
WIRE = Guidewire().scaled(0.36)  # the default one, long enough for every branch
PAIR = DevicePair(WIRE, load_catheter("vertebral"))
REST = 20  # control steps before the truth is read
PUSH, TURN = 0.002, 0.26  # of a full control step, m and rad
MOST_LEAD = 0.06  # of the wire before the catheter, m
ANOTHER_LEAD = 0.02  # probability of a step that another lead is wanted from there on


@dataclass(frozen=True)
class State:
    """A device at rest."""

    phantom: Phantom
    curve: Array  # from the entry to the tip, m. Shape (n, 3).
    insertion: float  # m
    rotation: float  # rad
    truth: RestingContacts
    catheter: tuple[float, float] | None = None  # insertion (m) and rotation (rad) of a catheter over the wire

    @property
    def forces(self) -> dict[str, float]:
        """The true numbers, N."""
        resultant = float(np.linalg.norm(self.truth.resultant))
        return {"resultant": resultant, "normal_sum": self.truth.normal_sum, "largest": self.truth.largest}


def states_at_rest(phantom: Phantom, count: int, seed: int, device: Device = WIRE) -> Iterator[State]:
    """Devices at rest after random pushes and turns, with a resultant of 0.03 N at least."""
    generator = np.random.default_rng(seed)
    moved = _Pair(phantom, device, generator) if isinstance(device, DevicePair) else _Wire(phantom, device)
    simulation = moved.simulation
    moved.begin(generator.uniform(-np.pi, np.pi))
    while count:
        goal, turn = generator.uniform(0.10, 0.30), generator.uniform(-0.5, 0.5)
        for _ in range(int((simulation.insertion - goal) / PUSH)):
            moved.move(-1.0, 0.0)
        for _ in range(250):
            if simulation.insertion > goal - 0.001:
                break
            moved.move(generator.normal(0.7, 0.4), turn + generator.normal(0.0, 0.35))
        lean, turn = generator.uniform(-1, 1, 2)
        for _ in range(generator.integers(5, 20)):
            moved.move(lean + generator.normal(0.0, 0.4), turn + generator.normal(0.0, 0.7))
        for _ in range(REST):
            moved.move(0.0, 0.0)
        curve = inserted_curve(simulation)
        truth = resting_contacts(simulation, observed_curve(curve, phantom, "descending", simulation.max_insertion))
        if simulation.valid and np.linalg.norm(truth.resultant) >= LEAST_RESULTANT:
            count -= 1
            yield State(phantom, curve, simulation.insertion, simulation.rotation, truth, moved.catheter())


class _Wire:
    """A wire that is moved by shares of a full step."""

    def __init__(self, phantom: Phantom, device: Guidewire) -> None:
        self.simulation = Simulation(phantom, device, ACCURACY["accurate"])

    def begin(self, rotation: float) -> None:
        self.simulation.reset(0.0, rotation)

    def move(self, push: float, turn: float) -> None:
        self.simulation.advance(PUSH * float(np.clip(push, -1, 1)), TURN * float(np.clip(turn, -1, 1)))

    def catheter(self) -> None:
        return None


class _Pair:
    """A wire in a catheter that follows it, 0 to `MOST_LEAD` behind, and is turned by its own."""

    def __init__(self, phantom: Phantom, device: DevicePair, generator: np.random.Generator) -> None:
        self.simulation, self._generator = DualSimulation(phantom, device, ACCURACY["accurate"]), generator
        self._wanted = 0.0  # lead, m

    def begin(self, rotation: float) -> None:
        self.simulation.reset(0.0, rotation, catheter=(0.0, self._generator.uniform(-np.pi, np.pi)))

    def move(self, push: float, turn: float) -> None:
        along, around = PUSH * float(np.clip(push, -1, 1)), TURN * float(np.clip(turn, -1, 1))
        if along == around == 0.0:
            self.simulation.advance(0.0, 0.0)
            return
        if self._generator.random() < ANOTHER_LEAD:
            self._wanted = self._generator.uniform(0.0, MOST_LEAD)
        follows = float(np.clip(self.simulation.device_lead + along - self._wanted, -PUSH, PUSH))
        turned = around * float(np.clip(self._generator.normal(0.5, 0.5), -1, 1))
        self.simulation.advance(along, around, catheter=(follows, turned))

    def catheter(self) -> tuple[float, float]:
        return self.simulation.catheter_place()


def compared(state: State, estimate: ContactForces) -> dict[str, float]:
    """Relative errors, whether the intervals hold the truth, and the largest contact's distance in mm."""
    row = {}
    for name, true in state.forces.items():
        found = getattr(estimate, name)
        row[name] = abs(found.value - true) / true
        row[f"{name}_log"] = float(np.log(max(found.value, 1e-4) / true))
        row[f"{name}_held"] = float(found.low <= true <= found.high)
        row[f"{name}_low"], row[f"{name}_high"] = found.low, found.high
        row[f"{name}_value"], row[f"{name}_true"] = found.value, true
        row[f"{name}_widening"] = needed_widening(found, true)
    if len(estimate.points) and len(state.truth.points):
        place = estimate.points[np.argmax(estimate.normal_forces)]
        row["place_mm"] = 1e3 * float(np.linalg.norm(place - state.truth.points[np.argmax(state.truth.normal_forces)]))
    return row


def needed_widening(found: Estimate, true: float) -> float:
    """The factor on the interval's half width, in logarithms, with which its end would be the truth."""
    value, truth = (float(np.log(max(number, 1e-4))) for number in (found.value, true))
    end = float(np.log(max(found.high if truth > value else found.low, 1e-4)))
    return abs(truth - value) / max(abs(end - value), 1e-9)


def measured(
    state: State, seed: int, noises: tuple[float, ...], members: int, workers: int, device: Device = WIRE
) -> dict[Any, dict]:
    """Rows of a state by case and noise; a pair is not estimated without feeder data."""
    rows = {}
    exact = ContactForceEstimator(state.phantom, device)
    errors = drawn_errors(state.phantom, device, Uncertainty(), np.random.default_rng(seed))

    def wrong(insertion: float, rotation: float) -> tuple[float, float]:
        return min(max(insertion + errors.insertion, 0.0), exact.max_insertion), rotation + errors.rotation

    feeders = (state.insertion, state.rotation), state.catheter
    wrong_feeders = wrong(*feeders[0]), None if state.catheter is None else wrong(*state.catheter)
    real = ContactForceEstimator(errors.phantom, errors.device, members=members, workers=workers)
    for noise in noises:
        curve = noisy_curve(state.curve, 1e-3 * noise, np.random.default_rng(seed))
        for case, estimator, (feeder, catheter) in (
            ("exact", exact, feeders),
            ("real", real, wrong_feeders),
            ("real, no feeder data", real, ((None, None), None)),
        ):
            if case == "real, no feeder data" and (noise != RECONSTRUCTED_MM or state.catheter is not None):
                continue
            estimator.reset()
            began = time.perf_counter()
            estimate = estimator.update(curve, *feeder, catheter=catheter)
            rows[case, noise] = {**compared(state, estimate), "s": time.perf_counter() - began}
    return rows


def interval(values: Array, groups: Array, statistic: Callable[[Array], float]) -> list[float]:
    """95 % interval of a statistic, the states drawn again (bootstrap)."""
    generator = np.random.default_rng(0)
    names = np.unique(groups)
    parts = [values[groups == name] for name in names]
    drawn = [
        statistic(np.concatenate([parts[i] for i in generator.integers(len(parts), size=len(parts))]))
        for _ in range(RESAMPLES)
    ]
    return [float(end) for end in np.percentile(drawn, [2.5, 97.5])]


def table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line a case and noise."""
    lines = []
    for case, noise in dict.fromkeys((row["case"], row["noise_mm"]) for row in rows):
        chosen = [row for row in rows if (row["case"], row["noise_mm"]) == (case, noise)]
        groups = np.array([row["state"] for row in chosen])
        line: dict[str, Any] = {"case": case, "noise_mm": noise, "n": len(chosen), "states": len(set(groups))}
        for name in QUANTITIES:
            errors = np.array([row[name] for row in chosen])
            line[name] = {
                "median_pct": 100 * float(np.median(errors)),
                "median_95": [100 * end for end in interval(errors, groups, lambda v: float(np.median(v)))],
                "p90_pct": 100 * float(np.percentile(errors, 90)),
                "p90_95": [100 * end for end in interval(errors, groups, lambda v: float(np.percentile(v, 90)))],
            }
            if not case.endswith("exact"):
                held = np.array([row[f"{name}_held"] for row in chosen])
                line[name]["held_pct"] = 100 * float(held.mean())
                line[name]["held_95"] = [100 * end for end in interval(held, groups, lambda v: float(np.mean(v)))]
                needed = np.array([row[f"{name}_widening"] for row in chosen])
                line[name]["widening"] = float(np.quantile(needed, 0.9))
                line[name]["widening_95"] = interval(needed, groups, lambda v: float(np.quantile(v, 0.9)))
        places = [row["place_mm"] for row in chosen if "place_mm" in row]
        line["place_mm"] = [float(np.median(places)), float(np.percentile(places, 90))]
        line["s"] = float(np.median([row["s"] for row in chosen]))
        lines.append(line)
    return lines


def printed(line: dict[str, Any]) -> str:
    """A line of the table as text."""
    text = f"{line['case']:22s} {line['noise_mm']:5.2f} {line['n']:4d}"
    for name in QUANTITIES:
        cell = line[name]
        held = f"{cell['held_pct']:5.0f}" if "held_pct" in cell else "    -"
        text += f" | {cell['median_pct']:5.1f} {cell['p90_pct']:6.1f} {held}"
    return text + f" | {line['place_mm'][0]:5.1f} {line['place_mm'][1]:6.1f} | {line['s']:.2f}"


def sequences(count: int, frames: int, members: int) -> dict[str, float]:
    """Frames a second and errors of the tracker on moving wires, 0.5 mm noise, real case, with feeder data."""
    errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    spent = total = 0.0
    for number in range(count):
        state = next(states_at_rest(load_phantom(NAMED[number % len(NAMED)]), 1, 900 + number))
        generator = np.random.default_rng(number)
        simulation = Simulation(state.phantom, WIRE, ACCURACY["accurate"])
        simulation.reset(0.0, state.rotation)
        for _ in range(75):
            simulation.advance(0.002, 0.0)
        case = drawn_errors(state.phantom, WIRE, Uncertainty(), np.random.default_rng(number))
        tracker = ContactForceEstimator(case.phantom, case.device, members=members, friction=WIRE.friction)
        for frame in range(frames):
            push, twist = generator.normal(0.5, 0.5), generator.normal(0.2, 0.7)
            simulation.advance(0.002 * float(np.clip(push, -1, 1)), 0.26 * float(np.clip(twist, -1, 1)))
            curve = inserted_curve(simulation)
            seen = observed_curve(curve, state.phantom, "descending", simulation.max_insertion)
            truth = resting_contacts(simulation, seen)
            feeder = min(max(simulation.insertion + case.insertion, 0.0), simulation.max_insertion)
            noise = np.random.default_rng(1000 * number + frame)
            noisy = noisy_curve(curve, 0.5e-3, noise)
            began = time.process_time()
            estimate = tracker.update(noisy, feeder, simulation.rotation + case.rotation)
            if frame > 0:
                spent, total = spent + time.process_time() - began, total + 1
            moving = State(state.phantom, curve, simulation.insertion, simulation.rotation, truth)
            if moving.forces["resultant"] >= LEAST_RESULTANT:
                row = compared(moving, estimate)
                for name in QUANTITIES:
                    errors[name].append(row[name])
    summary = {f"{name}_median_pct": 100 * float(np.median(values)) for name, values in errors.items()}
    summary |= {f"{name}_p90_pct": 100 * float(np.percentile(values, 90)) for name, values in errors.items()}
    return {"members": members, "frames_per_s": total / spent, "n": len(errors["resultant"]), **summary}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="six states, one seed, noise 0.5 mm")
    parser.add_argument("--training", action="store_true", help="other random arches: for choices and calibration")
    parser.add_argument(
        "--pair", action="store_true", help="a vertebral catheter over the wire; noise 0.5 mm, one draw"
    )
    parser.add_argument(
        "--arches", type=int, nargs=2, metavar=("FIRST", "COUNT"), help="a state in each of these alone"
    )
    parser.add_argument("--noises", type=float, nargs="+", help="of the curve, mm, instead of all")
    parser.add_argument("--members", type=int, default=MEMBERS, help="of the ensemble")
    parser.add_argument("--workers", type=int, default=1, help="threads")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of noise and errors at 0.5 mm; one at the others")
    parser.add_argument("--out", type=Path, help="gets every single row too")
    chosen = parser.parse_args()
    noises = (RECONSTRUCTED_MM,) if chosen.quick or chosen.training or chosen.pair else NOISES_MM
    noises = tuple(chosen.noises or noises)
    device = PAIR if chosen.pair else WIRE
    places: list[tuple[str, int | None, int]] = [(name, None, 2 if chosen.quick else NAMED_STATES) for name in NAMED]
    places += [
        ("random", seed, RANDOM_STATES) for seed in (() if chosen.quick else PAIR_RANDOM if chosen.pair else RANDOM)
    ]
    if chosen.training:
        places = [("random", seed, 3) for seed in TRAINING]
    if chosen.arches:
        places = [("random", chosen.arches[0] + one, RANDOM_STATES) for one in range(chosen.arches[1])]
    began, rows, number = time.perf_counter(), [], 0
    for name, seed, count in places:
        for state in states_at_rest(load_phantom(name, seed=seed), count, seed or 0, device):
            number += 1
            for draw in range(1 if chosen.quick or chosen.pair else chosen.seeds):
                found = measured(
                    state,
                    10 * number + draw,
                    noises if draw == 0 else (RECONSTRUCTED_MM,),
                    chosen.members,
                    chosen.workers,
                    device,
                )
                for (case, noise), row in found.items():
                    where = {"state": number, "anatomy": state.phantom.name, "seed": draw}
                    rows.append({**where, "case": case, "noise_mm": noise, **row})
            if chosen.out:
                chosen.out.write_text(json.dumps({"rows": rows}))
    lines = table(rows)
    head = " | ".join(f"{name:>19s}" for name in QUANTITIES)
    print(f"{'case':22s} noise    n | {head} | place, mm    | s\n{'':34s} | (median %, 90th percentile %, held %)")
    print("\n".join(printed(line) for line in lines))
    tracked = (
        []
        if chosen.pair or chosen.arches
        else [sequences(3, 10 if chosen.quick else 40, members) for members in (1, chosen.members)]
    )
    for line in tracked:
        print({key: round(value, 1) for key, value in line.items()})
    summary = {"states": number, "members": chosen.members, "wall_s": time.perf_counter() - began}
    if chosen.out:
        chosen.out.write_text(json.dumps({**summary, "table": lines, "sequences": tracked, "rows": rows}, indent=1))
    print(json.dumps({**summary, "table": lines, "sequences": tracked}))


if __name__ == "__main__":
    main()
