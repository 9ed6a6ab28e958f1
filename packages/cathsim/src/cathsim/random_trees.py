"""The environment of random trees: each episode draws a tree and a point of a carotid or vertebral artery."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cathsim.anatomy.generator.recipe import TREE
from cathsim.anatomy.point_target import Point, as_target
from cathsim.arch_variety import TEST_SEEDS as TEST_SEEDS
from cathsim.arch_variety import TRAINING_SEEDS
from cathsim.dual_device_nav import CATHETER, PLACEHOLDER, VIEW, WIRE, DualDeviceNavTask
from cathsim.guidewire import Guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.navigation import NavigationTask
from cathsim.vector import ThreadedVectorEnv

LENGTH = 1.05  # m of both devices: some vessels end farther from the groin than the published devices reach
LONG_WIRE = replace(WIRE.scaled(1.0), working_length=LENGTH)
LONG_CATHETER = replace(CATHETER, length=LENGTH)
GOALS = (
    "lcca",
    "rcca",
    *(f"{vessel}_{side}" for vessel in ("internal_carotid", "vertebral") for side in ("left", "right")),
)


class RandomTreesEnv(NavigateManyEnv):
    """DualDeviceNav in a tree of vessels that each episode draws, from the groin to both carotids and vertebrals.

    The target is a random point on the centrelines of `GOALS`, each as likely, and reached within 5 mm. All else is as
    of `DualDeviceNavEnv`, but for devices of 1.05 m; `info` also holds `case`, `phantom` (its name tells the seed) and
    `target`.

    Args:
        seeds: of the trees.
        wires: as of `NavigateManyEnv`.
        resolution: m between the nodes of the trees' grids.
        task: its fields as further keywords replace its own.
        arguments: of `NavigateEnv`, for every episode.

    Raises:
        ValueError: a seed that there is not.
    """

    def __init__(
        self,
        seeds: Sequence[int] = TRAINING_SEEDS,
        *,
        wires: Sequence[str | Guidewire | None] = (LONG_WIRE,),
        resolution: float = 1e-3,
        task: NavigationTask | None = None,
        **arguments: Any,
    ) -> None:
        for name in ("phantoms", "targets"):
            if name in arguments:
                raise ValueError(f"RandomTrees draws its {name}: leave {name} out")
        own = {"catheter": LONG_CATHETER, "observation": "tracking", "pace": "arch_variety", "view": VIEW}
        task = DualDeviceNavTask() if task is None else task
        trees = [(TREE, seed) for seed in seeds]
        super().__init__(trees, (PLACEHOLDER,), wires, resolution=resolution, **{**own, "task": task, **arguments})

    def _drawn_target(self) -> Point:
        tree = self.phantom.tree
        beyond = [tree[name].arc > tree.ostium_arc(name) for name in GOALS]
        points = np.concatenate([tree[name].points[out] for name, out in zip(GOALS, beyond, strict=True)])
        points = points[self.phantom.grid.sample(points) > 0]
        drawn = as_target(points[int(self.np_random.integers(len(points)))])
        assert not isinstance(drawn, str)
        return drawn


class ThreadedRandomTreesVectorEnv(ThreadedVectorEnv):
    """A `ThreadedVectorEnv` of `RandomTreesEnv`; arguments are those of both."""

    _make = RandomTreesEnv
