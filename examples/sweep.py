"""A sweep: the sampling expert with several wires and catheters, on all cores; a line as soon as a case is done.

    python examples/sweep.py

Sweeps of trainings, over a cluster too: python -m pipeline -m stage=enn seed=0,1,2 target=bca,lcca
"""

from __future__ import annotations

import itertools
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

from cathsim import NavigateEnv
from cathsim.planning.plan_trials import TWO_DEVICES, ExpertSettings
from cathsim.planning.sampling import SamplingExpert


def episode(wire: str, catheter: str | None, target: str, steps: int) -> tuple[bool, int, float]:
    """Steer to a target of the bovine arch; give success, steps, largest force (N)."""
    env = NavigateEnv("bovine", target, wire=wire, catheter=catheter, observation="tip", max_steps=steps)
    usual = TWO_DEVICES if catheter else ExpertSettings()
    quick = replace(usual, samples=12, elites=4, rounds=1)  # fewer plans than usual, as there are many cases
    expert, largest, ended = SamplingExpert(env, seed=0, threads=1, settings=quick), 0.0, False
    env.reset(seed=0)
    while not ended:
        _, _, terminated, truncated, info = env.step(expert.action())
        largest, ended = max(largest, info["force"]), terminated or truncated
    return terminated, env.steps, largest


def main(
    wires: tuple[str, ...] = ("default", "stiff"),
    catheters: tuple[str | None, ...] = (None, "vertebral"),
    targets: tuple[str, ...] = ("bca", "lcca"),
    steps: int = 200,
) -> dict[tuple[str, str | None, str], tuple[bool, int, float]]:
    """Run every combination; give its results."""
    cases = list(itertools.product(wires, catheters, targets))
    results = {}
    print(f"{len(cases)} cases in the bovine arch")
    with ProcessPoolExecutor(min(len(cases), os.cpu_count() or 1), mp_context=get_context("spawn")) as pool:
        for case, result in zip(cases, pool.map(episode, *zip(*cases, strict=True), [steps] * len(cases)), strict=True):
            results[case] = result
            (wire, catheter, target), (reached, taken, force) = case, result
            devices = f"{wire} wire" + (f" in a {catheter} catheter" if catheter else " alone")
            ending = f"{'reached' if reached else 'missed'} after {0.1 * taken:.1f} s, at most {force:.2f} N"
            print(f"{target.upper()}, {devices}: {ending}", flush=True)
    return results


if __name__ == "__main__":
    main()
