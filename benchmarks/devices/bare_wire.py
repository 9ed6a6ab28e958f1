"""Whether the wire without a catheter moves as it did, bit for bit: a digest of its joints over random motions.

    python benchmarks/devices/bare_wire.py [--phantoms A,B] [--steps N] [--seed N] [--solver mujoco|native]

Prints a line a phantom and preset: the digest of the joints' positions and velocities after every control step, and
where the tip ends (mm, world frame). Two checkouts whose wires move alike print the same lines. The contact solver of
MuJoCo is taken by default, since commits from before the native one have no other. Runs in older checkouts, too, from
the commit before catheters on: PYTHONPATH names the cathsim to be looked at.
"""

from __future__ import annotations

import argparse
import hashlib
import os
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import ACCURACY, Guidewire, Simulation, load_guidewire, load_phantom
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP

if TYPE_CHECKING:
    from cathsim.rung import Rung

PRESETS = ("accurate", "fast")
SOLVERS = ("mujoco", "native")
BURST, FORWARDS = (5, 40), 0.7  # control steps in which a motion stays; share of motions that insert


class WireOfMujoco(Simulation):
    """A wire whose contacts MuJoCo's own solver solves."""

    def _make_rung(self, wire: Guidewire) -> Rung:
        rung = super()._make_rung(wire)
        rung.struct.solver_rows = 0
        return rung


def digest(phantom: str, preset: str, solver: str, steps: int, seed: int) -> tuple[str, np.ndarray]:
    """Digest of all states, and the tip's last place (m)."""
    kind = WireOfMujoco if solver == "mujoco" else Simulation
    simulation = kind(load_phantom(phantom), load_guidewire("default"), ACCURACY[preset])
    simulation.reset()
    generator, states, left = np.random.default_rng(seed), hashlib.sha256(), 0
    translation = rotation = 0.0
    for _ in range(steps):
        if not left:
            left = int(generator.integers(*BURST))
            translation = TRANSLATION_STEP * (1.0 if generator.random() < FORWARDS else -1.0)
            rotation = ROTATION_STEP * generator.uniform(-1.0, 1.0)
        left -= 1
        simulation.advance(translation, rotation)
        states.update(np.concatenate((simulation.data.qpos, simulation.data.qvel)).tobytes())
    return states.hexdigest()[:16], np.array(simulation.tip)


def main() -> None:
    """Prints the digests."""
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n\n")[0], epilog=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phantoms", default="type_1,type_2", help="names, separated by commas")
    parser.add_argument("--steps", type=int, default=600, help="control steps of each")
    parser.add_argument("--seed", type=int, default=0, help="of the motions")
    parser.add_argument("--solver", choices=SOLVERS, default=SOLVERS[0], help="of the contacts")
    arguments = parser.parse_args()
    for phantom in arguments.phantoms.split(","):
        for preset in PRESETS:
            states, tip = digest(phantom, preset, arguments.solver, arguments.steps, arguments.seed)
            print(f"{phantom} {preset} {states} tip {', '.join(f'{1e3 * place:.6f}' for place in tip)}", flush=True)


if __name__ == "__main__":
    main()
