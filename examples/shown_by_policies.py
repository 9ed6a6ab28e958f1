"""A policy for anatomies that it has not seen, which learns from what other policies show. An hour on one core at most.

Wire and JB2 catheter to steep take-offs of ArchVariety: python examples/shown_by_policies.py. The policy that is
shipped was shown the way by `arch_variety_simmons2` of commit 6b117e8, whose place it has taken here.

Micro-guidewire and microcatheter from the groin to carotids and vertebrals:
python examples/shown_by_policies.py trees [SEED]. It goes on from `arch_variety_jb2`, in trees most of which have what
that fails in: a left carotid that leaves the BCA.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np
import torch

import enn
from cathsim.anatomy.generator.random_tree import RandomTree, build_random_tree
from cathsim.anatomy.point_target import Point, as_target, points_beyond_root
from cathsim.anatomy.vessel_tree import set_back
from cathsim.arch_variety import ArchVarietyEnv
from cathsim.dual_device_nav import LONG_CATHETER, LONG_WIRE
from cathsim.many_anatomies import SHELF, NavigateManyEnv
from enn.reinforcement.rehearsal import REHEARSAL, demonstrated, rehearse
from enn.trajectory import Trajectory

FOLDER, FOLDER_OF_TREES = "shown_by_policies", "shown_in_trees"
KEYS = ("roadmap", "history")
KINDS = ("II",) * 5 + ("IV",) * 4 + ("VI",) * 3 + ("I",) * 2 + ("V", "VII")  # hard types more often
STEEP = 0.005  # m that an ostium lies behind the top of the arch
HOLD = 2  # steps of 0.133 s for which an action is held
TREE = "random_tree"
TRAVEL, SPACING = 120, 20  # steps from the groin to the arch, and between the states of a miss that are kept
LEFT, RIGHT, VERTEBRAL = (
    ("lcca", "internal_carotid_left"),
    ("rcca", "internal_carotid_right"),
    ("vertebral_left", "vertebral_right"),
)

Case = tuple[str, int, Any]  # type and seed of an arch, or "random_tree" and that of a tree; target


class OwnPoints(NavigateManyEnv):
    """An anatomy and a target of its own in each case: all of them arches, or all of them trees."""

    def __init__(self, cases: list[Case], **arguments: Any) -> None:
        self.points = [case[2] for case in cases]
        trees = cases[0][0] == TREE
        super().__init__(
            [(kind if trees else f"arch_variety_{kind}", seed) for kind, seed, _ in cases],
            ("lcca",),  # a placeholder: each case has a point
            (LONG_WIRE if trees else "arch_variety",),
            catheter=LONG_CATHETER if trees else "jb2",
            success="straight" if trees else "lumen",
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


def tree_seeds(first: int, trees: int, *, bovine: bool) -> list[int]:
    """Give the first trees whose left carotid leaves the BCA, or the first in which it does not."""
    fitting = (seed for seed in count(first) if (build_random_tree(RandomTree(seed))["lcca"].parent == "bca") == bovine)
    return list(islice(fitting, trees))


def tree_cases(seeds: Sequence[int], groups: Sequence[tuple[str, ...]]) -> list[Case]:
    """Draw a point for each group of vessels in each tree."""
    cases: list[Case] = []
    for seed in seeds:
        generator, phantom = np.random.default_rng(seed), SHELF.take((TREE, seed), 1e-3)
        for group in groups:
            vessels = [phantom.tree[name] for name in group]
            points = np.concatenate([one.points[one.arc > phantom.tree.ostium_arc(one.name)] for one in vessels])
            points = points[phantom.grid.sample(points) > 0]
            cases.append((TREE, seed, as_target(points[generator.integers(len(points))])))
    return cases


def shown(
    cases: list[Case], policies: list[enn.Policy], draws: int, steps: int
) -> tuple[list[Trajectory], list[np.ndarray]]:
    """Let policies play every case by turns until one of them arrives.

    Returns:
        The episodes that did; of each other one states on its way from the first TRAVEL steps on.
    """
    env, episodes, missed = training_env(cases, steps), [], []
    for case in range(len(cases)):
        for number in range(draws):
            controller = policies[number % len(policies)].controller(deterministic=False, seed=draws * case + number)
            episode = demonstrated(controller, env, case, KEYS, seed=draws * case + number)
            if episode.terminated:
                episodes.append(episode)
                break
            missed.append(np.asarray(episode.simulation_states[TRAVEL::SPACING]))
        print(f"{len(episodes)} of {case + 1} cases were reached", flush=True)
    return episodes, [states for states in missed if len(states)]


def training_env(cases: list[Case], steps: int, **arguments: Any) -> OwnPoints:
    """Make an environment with the reward of the training."""
    return OwnPoints(cases, max_steps=steps, reward="geodesic", force_penalty=0.05, **arguments)


def main(
    arches: int = 96, decisions: int = 30_000, draws: int = 12, steps: int = 300, folder: str | None = FOLDER
) -> Any:
    """Train; give the result, whose policy steers as `enn.load("arch_variety_jb2")` does."""
    torch.set_num_threads(1)
    SHELF.capacity = max(SHELF.capacity, 2 * arches)
    start, other = enn.load("generalist_jb2"), enn.load("arch_variety_jb2")
    start.action_repeat = HOLD
    cases, validation = steep_cases(2000, arches), steep_cases(3000, -(-arches // 5))
    episodes, _ = shown(cases, [start, other], draws, steps)
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


def trees(
    trees: int = 16, decisions: int = 16_000, steps: int = 300, folder: str | None = FOLDER_OF_TREES, seed: int = 0
) -> Any:
    """Train in trees; give the result, whose policy is that of the last decision.

    It starts from the actor of `arch_variety_jb2`, which shows the way itself, and the critics of `generalist_jb2`;
    episodes begin at times where that one missed.
    """
    torch.set_num_threads(1)
    SHELF.capacity = max(SHELF.capacity, trees)
    start, actor = enn.load("generalist_jb2"), enn.load("arch_variety_jb2").module.state_dict()
    weights = start.module.state_dict()
    start.module.load_state_dict(weights | {name: actor[name] for name in weights if name.startswith("actor.")})
    start.action_repeat = HOLD
    hard = -(-3 * trees // 4)
    cases = tree_cases(tree_seeds(2000, hard, bovine=True), (LEFT, LEFT))
    cases += tree_cases(tree_seeds(2000, trees - hard, bovine=False), (LEFT, RIGHT, VERTEBRAL))
    episodes, missed = shown(cases, [start], 1, steps)
    settings = replace(
        REHEARSAL,
        decisions=decisions,
        buffer_size=max(decisions, 1000),
        evaluate_every=0,
        start_state_buffer_share=0.6,
        gradient_steps=1.0,
        learning_rate=1.5 * REHEARSAL.learning_rate,
        stop_after=0,
        overlap=False,
        n_envs=8,
    )
    return rehearse(
        partial(training_env, cases, steps, accuracy="fast", observe_every=HOLD),
        policy=start,
        settings=settings,
        demonstrations=episodes,
        starts=missed,
        folder=folder,
        seed=seed,
        metadata={"task": {"pace": "arch_variety", "catheter": "dual_device_nav/catheter.yaml"}},
        progress=lambda now: print(f"{now.decisions} of {now.total} decisions", flush=True),
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["trees"]:
        trees(seed=int(sys.argv[2]) if sys.argv[2:] else 0)
    else:
        main()
