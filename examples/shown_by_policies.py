"""A policy for arches that it has not seen, which learns from what other policies show. About an hour on one core.

Wire and JB2 catheter to steep take-offs of ArchVariety: python examples/shown_by_policies.py. The policy that is
shipped was shown the way by `arch_variety_simmons2` of commit 6b117e8, whose place it has taken here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

import enn
from cathsim.anatomy.point_target import Point, as_target, points_beyond_root
from cathsim.anatomy.vessel_tree import set_back
from cathsim.arch_variety import ArchVarietyEnv
from cathsim.many_anatomies import SHELF, NavigateManyEnv
from enn.reinforcement.rehearsal import REHEARSAL, demonstrated, rehearse
from enn.trajectory import Trajectory

FOLDER = "shown_by_policies"
KEYS = ("roadmap", "history")
KINDS = ("II",) * 5 + ("IV",) * 4 + ("VI",) * 3 + ("I",) * 2 + ("V", "VII")  # hard types more often
STEEP = 0.005  # m that an ostium lies behind the top of the arch
HOLD = 2  # steps of 0.133 s for which an action is held

Case = tuple[str, int, Any]  # type and seed of an arch, target


class SteepPoints(NavigateManyEnv):
    """An arch and a target of its own in each case."""

    def __init__(self, cases: list[Case], **arguments: Any) -> None:
        self.points = [case[2] for case in cases]
        arches = [(f"arch_variety_{kind}", seed) for kind, seed, _ in cases]
        super().__init__(
            arches,
            ("lcca",),  # a placeholder: each case has a point
            ("arch_variety",),
            catheter="jb2",
            pace="arch_variety",
            observation=KEYS,
            success_radius=0.005,
            start_rotation=math.pi,
            **arguments,
        )

    def _drawn_target(self) -> Point:
        point: Point = self.points[self.case]
        return point


def steep_cases(first: int, arches: int) -> list[Case]:
    """Draw two points behind steep take-offs in each arch, one of them in the left carotid, where there are some."""
    cases: list[Case] = []
    for number in range(arches):
        kind, seed = KINDS[number % len(KINDS)], first + number
        generator = np.random.default_rng(seed)
        phantom = ArchVarietyEnv([kind], [seed]).phantom
        places = [as_target(point) for point in points_beyond_root(phantom.tree, phantom.grid)]
        branches = [phantom.target(place).branch for place in places]
        steep = {branch for branch in set(branches) if set_back(phantom.tree, branch) >= STEEP}
        for wanted in (steep & {"lcca"}, steep):
            among = [place for place, branch in zip(places, branches, strict=True) if branch in wanted]
            cases += [(kind, seed, among[generator.integers(len(among))])] if among else []
    return cases


def shown(cases: list[Case], policies: list[enn.Policy], draws: int, steps: int) -> list[Trajectory]:
    """Let policies play every case by turns until one of them arrives; give the episodes that did."""
    env, episodes = training_env(cases, steps), []
    for case in range(len(cases)):
        for number in range(draws):
            controller = policies[number % len(policies)].controller(deterministic=False, seed=draws * case + number)
            episode = demonstrated(controller, env, case, KEYS, seed=draws * case + number)
            if episode.terminated:
                episodes.append(episode)
                break
        print(f"{len(episodes)} of {case + 1} cases were reached", flush=True)
    return episodes


def training_env(cases: list[Case], steps: int, **arguments: Any) -> SteepPoints:
    """Make an environment with the reward of the training."""
    return SteepPoints(cases, max_steps=steps, reward="geodesic", force_penalty=0.05, **arguments)


def main(
    arches: int = 96, decisions: int = 30_000, draws: int = 12, steps: int = 300, folder: str | None = FOLDER
) -> Any:
    """Train; give the result, whose policy steers as `enn.load("arch_variety_jb2")` does."""
    torch.set_num_threads(1)
    SHELF.capacity = max(SHELF.capacity, 2 * arches)
    start, other = enn.load("generalist_jb2"), enn.load("arch_variety_jb2")
    start.action_repeat = HOLD
    cases, validation = steep_cases(2000, arches), steep_cases(3000, -(-arches // 5))
    episodes = shown(cases, [start, other], draws, steps)
    settings = replace(
        REHEARSAL,
        decisions=decisions,
        buffer_size=decisions,
        evaluate_every=-(-decisions // 4),
        evaluation_episodes=len(validation),
        stop_after=0,
        overlap=False,
    )
    result = rehearse(
        partial(training_env, cases, 200, accuracy="fast", observe_every=HOLD),
        make_validation_env=partial(training_env, validation, steps, observe_every=HOLD),
        policy=start,
        settings=settings,
        demonstrations=episodes,
        folder=folder,
        metadata={"task": other.metadata["task"]},  # wire, catheter and pace
        progress=lambda now: print(f"{now.decisions} of {now.total} decisions, success {now.best_success}", flush=True),
    )
    print(f"reached {100 * result.evaluation['success']:.0f} % of {len(validation)} further targets")
    return result


if __name__ == "__main__":
    main()
