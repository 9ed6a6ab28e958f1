"""Cost of blood: steps of the environment with and without drag, in alternation.

    python benchmarks/cathsim/blood.py [--quick]

Prints a table and, as its last line, one JSON object:
    cost_pct         time that pulsatile blood adds to an environment step (accurate preset, tip observed), share of the
                     step without; median over rounds. Both environments take the same actions, in turns of 20 steps
    cost_steady_pct, cost_fast_pct, cost_image_pct
                     the same for steady blood; with the fast preset; with image and mask observed
    drag_pct         the drag alone: the same steps with blood at rest in everything but name, that is with the drag
                     computed but with no force (a density and viscosity of almost zero), so that the wire's way, and
                     with it the number of contacts, is the same
    field_build_s    building the velocity field of a phantom
    force_n          mean drag on the wire over an insertion into the brachiocephalic artery, N
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim import NavigateEnv, load_phantom
from cathsim.blood.field import BloodField
from cathsim.blood.flow import FLOWS, BloodFlow

TURN = 20  # steps
EPISODE = 100  # steps
NO_FORCE = BloodFlow(density=1e-12, viscosity=1e-12)


def actions_of(generator: np.random.Generator) -> np.ndarray:
    """An insertion with random rotation, shape (EPISODE, 2)."""
    actions = generator.uniform(-1.0, 1.0, (EPISODE, 2))
    actions[:, 0] = np.abs(actions[:, 0]) ** 0.3
    return actions


def alternate(environments: dict[str, NavigateEnv], rounds: int) -> dict[str, list[float]]:
    """Seconds of every episode, the environments taking turns of a few steps."""
    seconds: dict[str, list[float]] = {name: [] for name in environments}
    for index in range(rounds):
        actions = actions_of(np.random.default_rng(index))
        spent = dict.fromkeys(environments, 0.0)
        for environment in environments.values():
            environment.reset(seed=index)
        for first in range(0, EPISODE, TURN):
            # who begins changes, so that neither always finds the other's caches
            order = list(environments)[:: 1 if (first // TURN + index) % 2 else -1]
            for name in order:
                start = time.process_time()
                for action in actions[first : first + TURN]:
                    environments[name].step(action)
                spent[name] += time.process_time() - start
        for name, value in spent.items():
            seconds[name].append(value)
    return seconds


def cost(rounds: int, blood: str | BloodFlow, **arguments: object) -> dict[str, float]:
    """Added time in percent of a step, and steps/s without and with."""
    arguments = {"observation": "tip", "success_radius": 1e-6, "max_steps": 10**6, **arguments}
    environments = {"without": NavigateEnv(**arguments), "with": NavigateEnv(blood=blood, **arguments)}  # type: ignore[arg-type]
    alternate(environments, 1)
    seconds = alternate(environments, rounds)
    ratios = [b / a for a, b in zip(seconds["without"], seconds["with"], strict=True)]
    rates = {name: EPISODE / statistics.median(values) for name, values in seconds.items()}
    return {"cost_pct": 100 * (statistics.median(ratios) - 1), **rates}


def drag_force() -> float:
    """Mean over an insertion of the drag summed over the links, N."""
    environment = NavigateEnv(blood="pulsatile", observation="tip", success_radius=1e-6)
    environment.reset(seed=0)
    norms = []
    for action in actions_of(np.random.default_rng(0)):
        environment.step(action)
        norms.append(np.linalg.norm(environment.simulation.blood_forces(), axis=1).sum())
    return float(np.mean(norms))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer rounds, under 50 s")
    rounds = 11 if parser.parse_args().quick else 41
    cases: dict[str, tuple[str | BloodFlow, dict[str, object]]] = {
        "cost_pct": ("pulsatile", {}),
        "cost_steady_pct": ("steady", {}),
        "cost_fast_pct": ("pulsatile", {"accuracy": "fast"}),
        "cost_image_pct": ("pulsatile", {"observation": ("image", "mask")}),
        "drag_pct": (NO_FORCE, {}),
    }
    result: dict[str, float] = {}
    print(f"{'':18s}{'without, steps/s':>18s}{'with, steps/s':>16s}{'cost, %':>10s}")
    for name, (blood, arguments) in cases.items():
        measured = cost(rounds, blood, **arguments)
        result[name] = measured["cost_pct"]
        print(f"{name:18s}{measured['without']:18.0f}{measured['with']:16.0f}{measured['cost_pct']:10.1f}")
    start = time.perf_counter()
    BloodField(load_phantom("type_1"), FLOWS["pulsatile"])
    result["field_build_s"] = time.perf_counter() - start
    result["force_n"] = drag_force()
    print(f"field built in {result['field_build_s']:.2f} s; mean drag on the wire {result['force_n']:.3f} N")
    print(json.dumps({name: round(value, 4) for name, value in result.items()}))


if __name__ == "__main__":
    main()
