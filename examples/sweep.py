"""A sweep: the sampling expert with several wires and catheters, on all cores.

    python examples/sweep.py

Sweeps of trainings, over a cluster too: python -m pipeline -m stage=enn seed=0,1,2 target=bca,lcca
"""

from __future__ import annotations

import itertools
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from cathsim import NavigateEnv
from cathsim.planning.sampling import SamplingExpert


def episode(wire: str, catheter: str | None, target: str, steps: int) -> tuple[bool, int, float]:
    """Steer to a target of the bovine arch; give success, steps, largest force (N)."""
    env = NavigateEnv("bovine", target, wire=wire, catheter=catheter, observation="tip", max_steps=steps)
    expert, largest, ended = SamplingExpert(env, seed=0, threads=1), 0.0, False
    env.reset(seed=0)
    while not ended:
        _, _, terminated, truncated, info = env.step(expert.action())
        largest, ended = max(largest, info["force"]), terminated or truncated
    return terminated, env.steps, largest


def main(
    wires: tuple[str, ...] = ("default", "floppy", "stiff"),
    catheters: tuple[str | None, ...] = (None, "vertebral"),
    targets: tuple[str, ...] = ("bca", "lcca"),
    steps: int = 300,
) -> dict[tuple[str, str | None, str], tuple[bool, int, float]]:
    """Run every combination; give its results."""
    cases = list(itertools.product(wires, catheters, targets))
    with ProcessPoolExecutor(min(len(cases), os.cpu_count() or 1), mp_context=get_context("spawn")) as pool:
        results = dict(zip(cases, pool.map(episode, *zip(*cases, strict=True), [steps] * len(cases)), strict=True))
    for (wire, catheter, target), (reached, taken, force) in results.items():
        print(f"{wire:10} {catheter or '-':10} {target:5} {'yes' if reached else 'no':4} {taken:4} {force:.2f} N")
    return results


if __name__ == "__main__":
    main()
