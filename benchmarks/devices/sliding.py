"""How much Coulomb friction between wire and catheter, which the simulator leaves out, would add to the feeders.

    python benchmarks/devices/sliding.py [--quick] [--friction F] [--catheters A,B]

Both devices have one centreline, so a feeder slides one along the other whatever holds them: friction between them
changes what the feeders push with, not how the devices lie. Where both are, the wire's bending moment is
EI (curvature - its own), and what the catheter presses on it with is that moment's second derivative along the axis, a
transverse force at each joint of the chain, plus the wire's axial force times the bend. Friction is at most the
coefficient times the sum of these forces' magnitudes. They are read after each step of the sampling expert in Type I,
target BCA, and again from every second joint, which tells how far they depend on the links' lengths. Prints a table
and, as its last line, one JSON object. --quick takes the first 30 steps with the vertebral.
"""

from __future__ import annotations

import argparse
import json
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cathsim import NavigateEnv
from cathsim.devices.rod import WIRE
from cathsim.devices.simulation import DualSimulation
from cathsim.planning.expert_settings import TWO_DEVICES
from cathsim.planning.sampling import SamplingExpert

Array = NDArray[np.float64]

PHANTOM, TARGET = "type_1", "bca"
CATHETERS = ("vertebral", "simmons2")
FRICTION = 0.06  # between a wire and a catheter's lumen: as on the wall
MOST_STEPS, QUICK_STEPS = 300, 30


def pressing(simulation: DualSimulation, every: int = 1) -> float:
    """Sum of the magnitudes of the forces between wire and catheter, N, from every n-th joint."""
    wire = simulation.pair.wire
    assert wire is not None
    lengths = np.array(simulation.wire.links)[-simulation.active_links :]
    from_end = np.cumsum(lengths[::-1])[::-1][1:]  # of the joints
    cells = (lengths[1:] + lengths[:-1]) / 2
    bends = simulation.data.qpos[2:].reshape(-1, 2) @ np.array([1.0, 1.0j])
    lead = simulation.device_lead
    along = from_end - max(-lead, 0.0)
    samples = np.maximum(along[:, None] + cells[:, None] * (np.arange(-9.5, 10) / 20), 0.0)
    twist = simulation.twist[WIRE, -len(from_end) :]
    rest = wire.rest_curvature(samples).mean(axis=1) * np.exp(1j * twist)
    moments = np.where(along >= 0, wire.stiffness(np.maximum(along, 0.0)), 0.0) * (bends / cells - rest)
    moments, places, turns = moments[::every], from_end[::every], np.abs(bends)
    shear = np.append(np.diff(moments) / -np.diff(places), -moments[-1] / places[-1])
    covered = places >= abs(lead)  # where both are
    forces = np.abs(np.diff(shear))[covered[1:]].sum()
    axial = abs(float(simulation.feeder_forces()[WIRE]))
    return float(forces + axial * turns[from_end >= abs(lead)].sum())


def episode(catheter: str, steps: int) -> dict[str, Array]:
    """Pressing forces and the catheter's feeder force, N, after each step of the expert. Shape (T,) each."""
    environment = NavigateEnv(PHANTOM, TARGET, catheter=catheter, observation="tip", max_steps=steps)
    expert = SamplingExpert(environment, seed=0, settings=TWO_DEVICES, threads=1)
    environment.reset(seed=0)
    simulation = environment.simulation
    assert isinstance(simulation, DualSimulation)
    rows, ended = [], False
    while not ended:
        _, _, terminated, truncated, info = environment.step(expert.action())
        rows.append((pressing(simulation), pressing(simulation, 2), abs(float(info["feeder_forces"][1]))))
        ended = terminated or truncated
    return dict(zip(("pressing", "coarser", "feeder"), np.array(rows).T, strict=True))


def main() -> None:
    """Runs the episodes, prints a table and a JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="30 steps with the vertebral")
    parser.add_argument("--friction", type=float, default=FRICTION, help="coefficient between the devices")
    parser.add_argument("--catheters", default=",".join(CATHETERS), help="presets, with commas between")
    arguments = parser.parse_args()
    began, result = time.perf_counter(), {}
    print(f"{'catheter':<12} {'steps':>5} {'pressing, N':>20} {'2nd joints':>20} {'friction, N':>20} {'feeder, N':>20}")
    for catheter in ["vertebral"] if arguments.quick else arguments.catheters.split(","):
        found = episode(catheter, QUICK_STEPS if arguments.quick else MOST_STEPS)
        found["friction"] = arguments.friction * found["pressing"]
        row = {name: [round(float(np.percentile(values, at)), 4) for at in (50, 95)] for name, values in found.items()}
        texts = [f"{row[name][0]:11.3f} {row[name][1]:8.3f}" for name in ("pressing", "coarser", "friction", "feeder")]
        print(f"{catheter:<12} {len(found['feeder']):5d} {' '.join(texts)}", flush=True)
        result[catheter] = row
    print("median and 95th percentile over the steps")
    print(json.dumps({"friction": arguments.friction, **result, "seconds": round(time.perf_counter() - began, 1)}))


if __name__ == "__main__":
    main()
