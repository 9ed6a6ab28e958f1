"""The native solver of contacts beside MuJoCo's own: time a control step from the same states, and how far they part.

    python benchmarks/cathsim/contact_solver.py [--steps N] [--phantom NAME] [--seeds N]

Each control step of a random motion (bursts of full insertion, retraction and rotation) is made by both, in turns, from
the same state. MuJoCo's solver has the tolerance that cathsim gives it (1e-6). Prints a table and, as last line, one
JSON object; by devices and preset, medians over the seeds:
    ratio           processor time with MuJoCo's solver over that with the native one, control step
    ratios          of every seed
    step_ms         of the native one
    deep_ratio      ratio, of the steps with more than 200 mm in the vessel
    force_pct       difference of the resultant force in the last substep, of steps above 10 mN: 90th percentile, %
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import ACCURACY, Guidewire, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.devices.active_chain import ActiveChain
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP

DEVICES = ("wire", "vertebral", "jb2")
PRESETS = ("accurate", "fast")
DEEP, LEAST_FORCE = 0.2, 0.01  # m, N


def left_to_mujoco(chain: ActiveChain) -> ActiveChain:
    """The chain, whose contacts MuJoCo's own solver solves."""
    chain.struct.solver_rows = 0
    return chain


class WireOfMujoco(Simulation):
    """A wire whose contacts MuJoCo's own solver solves."""

    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        return left_to_mujoco(super()._make_chain(wire))


class DualOfMujoco(DualSimulation):
    """Two devices whose contacts MuJoCo's own solver solves."""

    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        return left_to_mujoco(super()._make_chain(wire))


def both_of(phantom: Phantom, devices: str, preset: str) -> tuple[Simulation, Simulation]:
    """The native solver's simulation and MuJoCo's."""
    wire, numerics = load_guidewire("default"), ACCURACY[preset]
    if devices == "wire":
        return Simulation(phantom, wire, numerics), WireOfMujoco(phantom, wire, numerics)
    pair = DevicePair(wire, load_catheter(devices))
    return DualSimulation(phantom, pair, numerics), DualOfMujoco(phantom, pair, numerics)


def advanced(simulation: Simulation, translation: float, rotation: float) -> float:
    """Makes a control step; its processor time, s."""
    moved, turned = TRANSLATION_STEP * translation, ROTATION_STEP * rotation
    start = time.process_time()
    if isinstance(simulation, DualSimulation):
        simulation.advance(moved, turned, catheter=(0.9 * moved, 0.5 * turned))
    else:
        simulation.advance(moved, turned)
    return time.process_time() - start


def compare(phantom: Phantom, devices: str, preset: str, seed: int, steps: int) -> dict[str, float]:
    """Plays a random motion with both."""
    simulations = both_of(phantom, devices, preset)
    own, mujocos = simulations
    generator = np.random.default_rng(seed)
    own.reset(0.0, generator.uniform(-np.pi, np.pi))
    spent, deep, parted = np.zeros((steps, 2)), np.zeros(steps, bool), []
    translation = rotation = 0.0
    for step in range(steps):
        if step % 20 == 0:
            translation = 1.0 if step < 100 or generator.random() < 0.65 else -1.0
            rotation = generator.choice([-1.0, 0.0, 1.0])
        state = own.state()
        for index in (0, 1) if step % 2 else (1, 0):
            simulations[index].restore(state)
            spent[step, index] = advanced(simulations[index], translation, rotation)
        deep[step] = own.insertion > DEEP
        size = float(np.linalg.norm(own.force()))
        if size > LEAST_FORCE:
            parted.append(float(np.linalg.norm(own.force() - mujocos.force())) / size)
        if not own.valid:
            own.reset()
    total = spent.sum(axis=0)
    far = spent[deep].sum(axis=0)
    return {
        "ratio": float(total[1] / total[0]),
        "deep_ratio": float(far[1] / far[0]) if deep.any() else float("nan"),
        "step_ms": float(1e3 * total[0] / steps),
        "force_pct": 100 * float(np.percentile(parted, 90)) if parted else float("nan"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=600, help="control steps of each run")
    parser.add_argument("--phantom", default="type_1", help="a named phantom")
    parser.add_argument("--seeds", type=int, default=3, help="random motions, from seed 0 on")
    arguments = parser.parse_args()
    phantom = load_phantom(arguments.phantom)
    result: dict[str, dict[str, object]] = {}
    for devices in DEVICES:
        for preset in PRESETS:
            runs = [compare(phantom, devices, preset, seed, arguments.steps) for seed in range(arguments.seeds)]
            row: dict[str, object] = {key: round(statistics.median(run[key] for run in runs), 3) for key in runs[0]}
            row["ratios"] = [round(run["ratio"], 3) for run in runs]
            result[f"{devices}, {preset}"] = row
            print(f"{devices}, {preset}: {row}", flush=True)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
