"""Contact forces from shape: what each error of a real case does to them alone.

    python benchmarks/cathsim/contact_force_sources.py [--arches N] [--draws N] [--members N] [--out rows.json]

One state at rest in each of some random arches, none of those that errors are reported for; the default wire. The
estimator is told the truth but for one thing: the noise of the curve (0.5 mm), the feeder's insertion or rotation, the
lumen's place or radius, the bending stiffness, each with the standard deviation of a real case; then all but the
stiffness, and all at once. The same draws in every case; arches that the file of rows holds are not run again. Prints
a line a case, with relative errors of the resultant and of the sum of normal forces, and last one JSON object.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cathsim.contact_forces import RECONSTRUCTED_MM, TRAINING, compared
from benchmarks.cathsim.states_at_rest import WIRE, State, states_at_rest
from cathsim.anatomy import load_phantom
from cathsim.statics import ContactForceEstimator, Uncertainty, drawn_errors, noisy_curve

REAL = Uncertainty()
NONE = Uncertainty(**{field.name: 0.0 for field in dataclasses.fields(REAL) if field.name != "curve_width"})
PARTS = ("insertion", "rotation", "registration", "lumen", "stiffness")
NOTHING, NOISE, BUT_STIFFNESS, ALL = "nothing", "noise of the curve", "all but the stiffness", "all of them"
QUANTITIES = ("resultant", "normal_sum")


def cases() -> dict[str, tuple[Uncertainty, float]]:
    """What is wrong in each case: standard deviations, and the noise of the curve in m."""
    noise = 1e-3 * RECONSTRUCTED_MM
    alone = {part: (dataclasses.replace(NONE, **{part: getattr(REAL, part)}), 0.0) for part in PARTS}
    measured = dataclasses.replace(REAL, stiffness=0.0)
    return {NOTHING: (NONE, 0.0), NOISE: (NONE, noise), **alone, BUT_STIFFNESS: (measured, noise), ALL: (REAL, noise)}


def estimated(state: State, seed: int, wrong: Uncertainty, noise: float, members: int) -> dict[str, float]:
    """Relative errors of one estimate."""
    errors = drawn_errors(state.phantom, WIRE, wrong, np.random.default_rng(seed))
    curve = noisy_curve(state.curve, noise, np.random.default_rng(seed))
    estimator = ContactForceEstimator(errors.phantom, errors.device, members=members)
    insertion = min(max(state.insertion + errors.insertion, 0.0), estimator.max_insertion)
    row = compared(state, estimator.update(curve, insertion, state.rotation + errors.rotation))
    return {name: row[f"{name}_log"] for name in QUANTITIES}


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Median and 90th percentile of the relative error of each quantity, %."""
    table = {}
    for name in QUANTITIES:
        errors = 100 * np.abs(np.expm1([row[name] for row in rows]))
        table[name] = {"median_pct": float(np.median(errors)), "p90_pct": float(np.percentile(errors, 90))}
    return table


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arches", type=int, default=len(TRAINING))
    parser.add_argument("--draws", type=int, default=2, help="of the errors, a state")
    parser.add_argument("--members", type=int, default=1, help="of the ensemble")
    parser.add_argument("--out", type=Path, help="gets every single row")
    chosen = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(chosen.out.read_text()) if chosen.out and chosen.out.exists() else []
    chosen_size = {"draws": chosen.draws, "members": chosen.members}
    if any({name: row.get(name) for name in chosen_size} != chosen_size for row in rows):
        sys.exit(f"{chosen.out} holds rows of other --draws or --members: give another --out")
    there = {row["arch"] for row in rows}
    for arch in (arch for arch in TRAINING[: chosen.arches] if arch not in there):
        state = next(states_at_rest(load_phantom("random", seed=arch), 1, arch))
        for draw in range(chosen.draws):
            for case, (wrong, noise) in cases().items():
                if case == NOTHING and draw:
                    continue
                found = estimated(state, 10 * arch + draw, wrong, noise, chosen.members)
                rows.append({"arch": arch, "draw": draw, "case": case, **chosen_size, **found})
        if chosen.out:
            chosen.out.write_text(json.dumps(rows))
    table = {case: summary([row for row in rows if row["case"] == case]) for case in cases()}
    for case, line in table.items():
        cells = " | ".join(f"{line[name]['median_pct']:5.1f} / {line[name]['p90_pct']:5.1f}" for name in QUANTITIES)
        print(f"{case:22s} | {cells}")
    print(json.dumps({"states": chosen.arches, "draws": chosen.draws, "members": chosen.members, "table": table}))


if __name__ == "__main__":
    main()
