"""Convex hulls beside the signed-distance grid: how well they fit the wall, what they cost, how deep the wire goes in.

    python benchmarks/cathsim/hulls.py [--quick] [--phantom NAME]

Each decomposition is made again and timed, then driven with the same wire and actions as the grid, in turns. Prints
tables and, as its last line, one JSON object; of the default decomposition (quick: coarser, searched less):
    hulls                                 number of hulls
    build_s, build_cpu_s                  time to make them, two threads at most; processor time
    intrusion_p50_mm, _p99_mm, _max_mm    how far hulls reach into the true lumen, along the normals of its surface
    blocked_pct                           share of the wall over which they reach the middle of the lumen
    leak_pct                              share of the wall without a hull behind it
    speed_ratio                           agent steps/s with hulls over those with the grid, median over rounds
    penetration_p99_mm, hull_depth_p99_mm of the wire: beyond the true wall (every substep), into hulls (every step)
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from dataclasses import dataclass, field, replace

os.environ.setdefault("OMP_NUM_THREADS", "2")

import numpy as np

from benchmarks.cathsim.wall_fit import wall_fit
from cathsim import ACCURACY, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.contact.hulls import Decomposition, Hull, wall_hulls
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
from cathsim.export import EXPORT_NUMERICS
from cathsim.presets import Accuracy

QUICK = Decomposition(lattice=3.0e-3, search=20)
THRESHOLDS = (0.05, 0.02, 0.01)


@dataclass
class Drive:
    """A simulation under way, and what it measured."""

    simulation: Simulation
    rates: list[float] = field(default_factory=list)
    depths: list[np.ndarray] = field(default_factory=list)
    hull_depths: list[float] = field(default_factory=list)
    forces: list[float] = field(default_factory=list)
    invalid: int = 0

    def run(self, seed: int, steps: int) -> None:
        """Bursts of full insertion, retraction and rotation."""
        simulation, generator = self.simulation, np.random.default_rng(seed)
        simulation.reset(0.0, generator.uniform(-np.pi, np.pi))
        translation = rotation = spent = 0.0
        for step in range(steps):
            if step % 20 == 0:
                translation = 1.0 if step < 100 or generator.random() < 0.65 else -1.0
                rotation = generator.choice([-1.0, 0.0, 1.0])
            start = time.process_time()
            simulation.advance(TRANSLATION_STEP * translation, ROTATION_STEP * rotation)
            spent += time.process_time() - start
            contact = simulation.data.contact
            self.depths.append(simulation.depths.copy())
            self.hull_depths.append(max(0.0, -float(contact.dist.min())) if simulation.data.ncon else 0.0)
            self.forces.append(simulation.summary.force_max)
            if not simulation.valid:
                self.invalid += 1
                simulation.reset()
        self.rates.append(steps / spent)


def fit(phantom: Phantom, settings: Decomposition) -> dict[str, float]:
    """Makes the hulls, which stay in the cache, and compares them with the wall."""
    start, start_cpu = time.perf_counter(), time.process_time()
    hulls = wall_hulls(phantom, settings)
    built, built_cpu = time.perf_counter() - start, time.process_time() - start_cpu
    wall = wall_fit(phantom, hulls)
    p50, p99 = np.percentile(wall.intrusion, [50, 99]) * 1e3
    clearance = {
        branch.name: -1e3 * max(float((o - branch.points[3:-8] @ n.T).min(1).max()) for n, o in map(_planes, hulls))
        for branch in phantom.tree
    }
    narrowest = min(clearance, key=lambda name: clearance[name])
    print(
        f"{settings.threshold:9.2f}{len(hulls):7d}{built:9.1f}{built_cpu:8.1f}{p50:8.2f}{p99:8.2f}"
        f"{wall.intrusion.max() * 1e3:8.2f}{100 * wall.blocked.mean():11.1f}{100 * wall.leak_share:8.2f}"
        f"{clearance[narrowest]:12.2f} ({narrowest})"
    )
    return {
        "hulls": len(hulls),
        "build_s": built,
        "build_cpu_s": built_cpu,
        "intrusion_p50_mm": p50,
        "intrusion_p99_mm": p99,
        "intrusion_max_mm": wall.intrusion.max() * 1e3,
        "blocked_pct": 100 * wall.blocked.mean(),
        "leak_pct": 100 * wall.leak_share,
    }


def _planes(hull: Hull) -> tuple[np.ndarray, np.ndarray]:
    return hull.planes()


def race(phantom: Phantom, all_settings: list[Decomposition], rounds: int, steps: int) -> dict[str, float]:
    """Grid and hulls in turns; figures of the first settings."""
    wire, accurate = load_guidewire("default"), ACCURACY["accurate"]

    def make(contact: str | Decomposition, numerics: Accuracy = accurate) -> Drive:
        return Drive(Simulation(phantom, wire, numerics, contact=contact, measure_penetration=True))

    drives = {"grid, accurate": make("sdf")}
    for settings in all_settings:
        drives[f"hulls {settings.threshold:g}, accurate"] = make(settings)
    drives[f"hulls {all_settings[0].threshold:g}, plain 2 ms"] = make(all_settings[0], EXPORT_NUMERICS)
    drives["grid, plain 2 ms"] = make("sdf", EXPORT_NUMERICS)
    for seed in range(rounds):
        for drive in drives.values():
            drive.run(seed, steps)
    print(f"\n{'':26s}{'steps/s':>9s}{'ratio':>7s}{'in the wall, mm':>17s}{'in hulls, mm':>14s}{'force, N':>16s}")
    print(f"{'':26s}{'':>16s}{'p99':>9s}{'max':>8s}{'p99':>7s}{'max':>7s}{'p50':>8s}{'p99':>8s}{'invalid':>9s}")
    grid = drives["grid, accurate"].rates
    rows = {}
    for name, drive in drives.items():
        ratio = statistics.median(a / b for a, b in zip(drive.rates, grid, strict=True))
        wall = np.concatenate(drive.depths) * 1e3
        hull = np.array(drive.hull_depths) * 1e3
        rows[name] = {
            "speed_ratio": ratio,
            "penetration_p99_mm": np.percentile(wall, 99),
            "hull_depth_p99_mm": np.percentile(hull, 99),
        }
        hulled = name.startswith("hulls")
        own = f"{np.percentile(hull, 99):7.2f}{hull.max():7.2f}" if hulled else f"{'-':>7s}{'-':>7s}"
        print(
            f"{name:26s}{statistics.median(drive.rates):9.0f}{ratio:7.2f}"
            f"{np.percentile(wall, 99):9.2f}{wall.max():8.2f}{own}"
            f"{np.median(drive.forces):8.3f}{np.percentile(drive.forces, 99):8.3f}{drive.invalid:9d}"
        )
    return rows[f"hulls {all_settings[0].threshold:g}, accurate"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one coarse decomposition, under 50 s")
    parser.add_argument("--phantom", default="type_1")
    given = parser.parse_args()
    phantom = load_phantom(given.phantom)
    default = Decomposition()
    all_settings = [QUICK] if given.quick else [replace(default, threshold=value) for value in THRESHOLDS]
    print(f"{phantom.name}{'; quick: coarser lattice, shorter search' if given.quick else ''}\n")
    print(
        f"{'threshold':>9s}{'hulls':>7s}{'built, s':>9s}{'CPU, s':>8s}{'p50':>8s}{'p99':>8s}{'max':>8s}"
        f"{'blocked, %':>11s}{'leak, %':>8s}{'narrowest':>12s}"
        "      (intrusion and free radius around the centreline in mm)"
    )
    with tempfile.TemporaryDirectory() as empty:
        os.environ["CATHSIM_CACHE"] = empty  # so that nothing is found ready-made
        result = {settings.threshold: fit(phantom, settings) for settings in all_settings}
        all_settings.sort(key=lambda settings: settings.threshold != default.threshold)
        rounds, steps = (3, 100) if given.quick else (6, 240)
        raced = race(phantom, all_settings, rounds, steps)
    chosen = {**result[default.threshold], **raced}
    print(json.dumps({name: round(float(value), 4) for name, value in chosen.items()}))


if __name__ == "__main__":
    main()
