"""What the settings of the load cell change in its reading, and what the flow alone gives on the empty vessel.

    python benchmarks/forces/load_cell.py [--quick] [--seeds N]

The same episodes of the sampling expert (wire alone, friction 0.06, all targets), read with other calibrations, filters
and references. Prints tables and, as its last line, one JSON object. --quick takes one seed.
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

from benchmarks.forces.episodes import PHANTOM, WIRE, Episode, expert_episodes
from cathsim import Phantom, load_phantom
from cathsim.blood.field import blood_field
from cathsim.blood.flow import FLOWS
from cathsim.metrics.load_cell import MINI40


def cell_settings(episodes: Sequence[Episode]) -> dict[str, dict[str, float]]:
    """Mean and SD of the reading with other settings of the cell, over the same episodes, N."""
    variants: dict[str, dict[str, Any]] = {
        "true load": {"calibration": "SI-20-1", "resolution": (0.0, 0.0, 0.0), "cutoff": 0.0},
        **{name: {"calibration": name} for name in MINI40},
        "no filter": {"calibration": "SI-20-1", "cutoff": 0.0},
        "filter of 0.5 Hz": {"calibration": "SI-20-1", "cutoff": 0.5},
        "tared": {"calibration": "SI-20-1", "tared": True},
        "with the sheath": {"calibration": "SI-20-1", "sheath": True},
    }
    rows = {}
    for name, settings in variants.items():
        pooled = np.concatenate([one.reading(**settings) for one in episodes])
        rows[name] = {"mean": float(pooled.mean()), "sd": float(pooled.std())}
    largest = np.concatenate([one.resultants for one in episodes])
    rows["largest resultant of a step"] = {"mean": float(largest.mean()), "sd": float(largest.std())}
    return rows


def flow_force(phantom: Phantom) -> dict[str, float]:
    """Force of the pulsatile flow on the empty vessel, N: change of momentum, without the pressure at the ends.

    In the direction of the stream the fluid's momentum per length is density x flow; what enters at the root and what
    leaves at the ends carries density x flow^2 / area (a blunt profile).
    """
    field = blood_field(phantom, FLOWS["pulsatile"])
    density, period = field.flow.density, 1.0 / field.flow.heart_rate
    times = np.arange(96) / 96 * period
    flow = field.flow_rate(times)
    rate = (np.roll(flow, -1) - np.roll(flow, 1)) / (2 * period / 96)
    stored, flux = np.zeros(3), np.zeros(3)
    for branch in phantom.tree:
        arc = np.linspace(0.0, branch.length, 400)
        downstream = -1.0 if branch.parent is None else 1.0
        tangent, carried = downstream * branch.tangent_at(arc), field.carried(branch.name, arc)
        stored += np.trapezoid(carried[:, None] * tangent, arc, axis=0)
        area = np.pi * branch.radius_at(arc) ** 2
        if branch.parent is None:
            flux += carried[-1] ** 2 / area[-1] * tangent[-1] - carried[0] ** 2 / area[0] * tangent[0]
        elif branch.open_end:
            flux -= carried[-1] ** 2 / area[-1] * tangent[-1]
    force = density * (flow[:, None] ** 2 * flux - rate[:, None] * stored)
    size = np.linalg.norm(force, axis=1)
    return {"mean": float(size.mean()), "sd": float(size.std()), "max": float(size.max())}


def main() -> None:
    """Reads the episodes in all ways, prints tables and a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one seed")
    parser.add_argument("--seeds", type=int, default=3, help="episodes to each target")
    arguments = parser.parse_args()
    began = time.perf_counter()
    episodes = expert_episodes(WIRE, 1 if arguments.quick else arguments.seeds)
    result: dict[str, Any] = {
        "episodes": len(episodes),
        "settings": cell_settings(episodes),
        "flow": flow_force(load_phantom(PHANTOM)),
    }
    for name, row in result["settings"].items():
        print(f"{name:<30} {row['mean']:6.3f} ± {row['sd']:.3f} N")
    flow = result["flow"]
    print(f"{'flow alone, empty vessel':<30} {flow['mean']:6.3f} ± {flow['sd']:.3f} N, at most {flow['max']:.3f} N")
    print(json.dumps(result | {"seconds": round(time.perf_counter() - began, 1)}))


if __name__ == "__main__":
    main()
