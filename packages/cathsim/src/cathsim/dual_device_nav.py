"""DualDeviceNav: a wire in a microcatheter, from the groin to carotids and vertebrals, also in drawn trees."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.anatomy import load_phantom
from cathsim.anatomy.dual_device_nav import published_folder, target_points
from cathsim.anatomy.generator.recipe import TREE
from cathsim.anatomy.point_target import Point, as_target
from cathsim.arch_variety import TRAINING_SEEDS, ArchVarietyTask
from cathsim.devices.device_file import PRESETS
from cathsim.devices.shelf import load_catheter
from cathsim.environment import NavigateEnv
from cathsim.guidewire import Guidewire, load_guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.navigation import NavigationTask
from cathsim.registration.usage import exclusive
from cathsim.validation import Count, settings
from cathsim.vector import ThreadedVectorEnv

TRAINING_STEPS, TEST_STEPS = 500, 1000  # 67 s and 133 s
VIEW = (20.0, 5.0)  # degrees
DEVICES = PRESETS / "dual_device_nav"
WIRE, CATHETER = load_guidewire(DEVICES / "guidewire.yaml"), load_catheter(DEVICES / "catheter.yaml")
PLACEHOLDER = "lcca"  # the target, before an episode draws its own
_SEEDS = 2**31

# Seeds of the 98 episodes in which the task is evaluated, as published.
TEST_SEEDS: tuple[int, ...] = (
    *(1, 2, 3, 5, 6, 7, 8, 9, 10, 12, 13, 14, 16, 17, 18, 21, 22, 23, 27, 31, 34, 35, 37, 39, 42, 43, 44, 47, 48, 50),
    *(52, 55, 56, 58, 61, 62, 63, 68, 69, 70, 71, 73, 79, 80, 81, 84, 89, 91, 92, 93, 95, 97, 102, 103, 108, 109, 110),
    *(115, 116, 117, 118, 120, 122, 123, 124, 126, 127, 128, 129, 130, 131, 132, 134, 136, 138, 139, 140, 141, 142),
    *(143, 144, 147, 148, 149, 150, 151, 152, 154, 155, 156, 158, 159, 161, 162, 167, 168, 171, 175),
)


@settings
class DualDeviceNavTask(ArchVarietyTask):
    """The tip within 5 mm of the target in a straight line; the published reward, as that of `ArchVarietyTask`."""

    max_steps: Count = TEST_STEPS


class DualDeviceNavEnv(NavigateEnv):
    """A micro-guidewire in a microcatheter is fed from the left iliac artery to a carotid or vertebral artery.

    The target is a random point on the centrelines of both carotids and both vertebrals, each as likely, and reached
    within 5 mm; `reset(seed=s)` draws the one that the published task draws for its seed s. Actions are translation, at
    most 35 mm/s, and rotation, at most 180 degrees/s, of both feeders, 7.5 times a second. `info["success_lumen"]` says
    whether the target is reached along the lumen, too.

    Observation by default `tracking`: `Box(18,)`, in a view turned by 20 and 5 degrees. Reward and endings are those of
    `DualDeviceNavTask`.

    Args:
        folder: of the published surface and centrelines, data/dualdevicenav of lkarstensen/stEVE_bench; None: that of
            the environment variable CATHSIM_DUALDEVICENAV.
        resolution: m between the nodes of the grid.
        task: its fields as further keywords replace its own.
        arguments: of `NavigateEnv`.

    Raises:
        ValueError: the files are not there; says where to get them.
    """

    def __init__(
        self,
        folder: str | Path | None = None,
        *,
        resolution: float = 1e-3,
        task: NavigationTask | None = None,
        **arguments: Any,
    ) -> None:
        for name in ("phantom", "target"):
            if name in arguments:
                raise ValueError(f"DualDeviceNav has its own {name}: leave {name} out")
        own = {"wire": WIRE, "catheter": CATHETER, "observation": "tracking", "pace": "arch_variety", "view": VIEW}
        phantom = load_phantom(published_folder(folder), resolution=resolution)
        task = DualDeviceNavTask() if task is None else task
        super().__init__(phantom, PLACEHOLDER, task=task, **{**own, **arguments})
        self._points = target_points(phantom)

    @exclusive
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode towards a point that is drawn; arguments as of `NavigateEnv.reset`."""
        options = dict(options or {})
        if options.get("target") is None:
            generator = self.np_random if seed is None else np.random.default_rng(seed)
            generator.integers(0, _SEEDS)  # the published task's first draw, of the vessels, which are always the same
            drawn = random.Random(int(generator.integers(0, _SEEDS)))
            options["target"] = self._points[drawn.choice(range(len(self._points)))]
        return super().reset(seed=seed, options=options)


class ThreadedDualDeviceNavVectorEnv(ThreadedVectorEnv):
    """A `ThreadedVectorEnv` of `DualDeviceNavEnv`; arguments are those of both."""

    _make = DualDeviceNavEnv


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
