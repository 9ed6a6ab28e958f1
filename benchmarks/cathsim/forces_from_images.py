"""Contact forces of a wire from two X-ray images: read, reconstructed, laid in the vessel; against the simulator's.

Truth is a wire at rest after random pushes and turns. Its two images are noisy, in a patient's surroundings; guide3d
reads and reconstructs the wire with the exact cameras. `exact`: the estimator knows all but the curve. `real`: its
insertion, rotation, lumen and bending stiffness are wrong as in `contact_forces.py`. The rows `simulated` have the true
curve in place of the reconstructed one, on the same states. The last line is JSON.

    python -m benchmarks.cathsim.forces_from_images [--arches 400 100] [--members 40] [--out results.json]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cathsim.contact_forces import compared, printed, table
from benchmarks.cathsim.states_at_rest import WIRE, State, states_at_rest
from cathsim.anatomy import load_phantom
from cathsim.fluoroscopy import BiplaneFluoroscope, write_calibration
from cathsim.statics import ContactForceEstimator, Uncertainty, curve_from_entry, drawn_errors
from cathsim.statics.estimator import MEMBERS
from guide3d import read_camera, read_pair

NAMED = ("type_1", "type_2", "bovine")
NAMED_STATES = 2
RANDOM = (400, 20)  # first seed and number of arches with a state each
SIZE = 1024  # px
CURVES = ("simulated", "reconstructed")

Array = NDArray[np.float64]


def reconstructed(state: State, fluoroscope: BiplaneFluoroscope, seed: int) -> tuple[Array, str]:
    """The curve from the entry to the tip as two images show it, m, and why it is not to be trusted, if it is not."""
    frames = fluoroscope.render(state.nodes, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        write_calibration(fluoroscope.cameras, Path(folder))
        cameras = [read_camera(Path(folder) / f"projection_{name}.txt") for name in fluoroscope.names]
    first, second = (frames[name].image for name in fluoroscope.names)
    wire = read_pair(first, second, cameras)
    return curve_from_entry(1e-3 * wire.curve_mm, state.phantom), wire.refusal


def distance_mm(curve: Array, truth: Array) -> float:
    """Root mean square distance of a curve's points from the true one, mm."""
    from scipy.spatial import cKDTree

    fine = np.concatenate([truth[:-1] + share * np.diff(truth, axis=0) for share in np.linspace(0, 1, 20)])
    return 1e3 * float(np.sqrt(np.mean(cKDTree(fine).query(curve)[0] ** 2)))


def measured(
    state: State, curves: dict[str, Array], seed: int, members: int, workers: int
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Rows of a state by curve and case, and why others were refused."""
    exact = ContactForceEstimator(state.phantom, WIRE)
    errors = drawn_errors(state.phantom, WIRE, Uncertainty(), np.random.default_rng(seed))
    real = ContactForceEstimator(errors.phantom, errors.device, members=members, workers=workers)
    insertion = min(max(state.insertion + errors.insertion, 0.0), exact.max_insertion)
    wrong = insertion, state.rotation + errors.rotation
    rows, refused = {}, {}
    for name, curve in curves.items():
        for case, estimator, feeder in (
            ("exact", exact, (state.insertion, state.rotation)),
            ("real", real, wrong),
            ("real, no feeder data", real, (None, None)),
        ):
            estimator.reset()
            began = time.perf_counter()
            try:
                found = compared(state, estimator.update(curve, *feeder))
            except ValueError as error:  # the curve does not fit the feeder: the wire was not read whole
                refused[f"{name}, {case}"] = str(error)
            else:
                rows[f"{name}, {case}"] = {**found, "s": time.perf_counter() - began}
    return rows, refused


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--arches", type=int, nargs=2, metavar=("FIRST", "COUNT"), help="a state in each of these random arches alone"
    )
    parser.add_argument("--geometry", default="clinical", help="of the cameras: clinical or guide3d")
    parser.add_argument("--members", type=int, default=MEMBERS, help="of the ensemble")
    parser.add_argument("--workers", type=int, default=1, help="threads")
    parser.add_argument("--out", type=Path, help="gets every single row too")
    chosen = parser.parse_args()
    first, count = chosen.arches or RANDOM
    places: list[tuple[str, int | None, int]] = [("random", first + one, 1) for one in range(count)]
    if not chosen.arches:
        places += [(name, None, NAMED_STATES) for name in NAMED]
    began, rows, misses, errors, number = time.perf_counter(), [], [], [], 0
    for name, seed, count in places:
        phantom = load_phantom(name, seed=seed)
        fluoroscope = BiplaneFluoroscope.of(phantom, chosen.geometry, surroundings="patient", size=SIZE)
        for state in states_at_rest(phantom, count, seed or 0):
            number += 1
            where = {"state": number, "anatomy": name if seed is None else f"{name} {seed}"}
            try:
                curve, refusal = reconstructed(state, fluoroscope, 100 + number)
            except ValueError as error:
                curve, refusal = state.curve, str(error)
            if refusal:
                misses.append({**where, "why": refusal})
                continue
            errors.append(distance_mm(curve, state.nodes))
            curves = dict(zip(CURVES, (state.curve, curve), strict=True))
            found, refused = measured(state, curves, 10 * number, chosen.members, chosen.workers)
            misses += [{**where, "case": case, "why": why} for case, why in refused.items()]
            for case, row in found.items():
                rows.append({**where, "case": case, "noise_mm": 0.0, "curve_mm": errors[-1], **row})
            print(where, f"{errors[-1]:.2f} mm", flush=True)
    lines = table(rows)
    print("\n".join(printed(line) for line in lines))
    summary = {
        "states": number,
        "missing": misses,
        "curve_mm": [float(np.median(errors)), float(np.percentile(errors, 90))],
        "wall_s": time.perf_counter() - began,
    }
    if chosen.out:
        chosen.out.write_text(json.dumps({**summary, "table": lines, "rows": rows}, indent=1))
    print(json.dumps({**summary, "table": lines}))


if __name__ == "__main__":
    main()
