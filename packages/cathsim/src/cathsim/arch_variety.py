"""The environment of ArchVariety: each episode draws an arch and a point on a centreline above the aorta."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from annotated_types import Interval

from cathsim.anatomy.generator.recipe import VARIETY
from cathsim.anatomy.generator.variety_arch import ARCH_TYPES
from cathsim.anatomy.point_target import Point, as_target, points_beyond_root
from cathsim.guidewire import Guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.navigation import NEAR, NavigationTask
from cathsim.presets import Pace
from cathsim.validation import Count, Unit, settings
from cathsim.vector import ThreadedVectorEnv

AT_TARGET, STEP_COST = 1.0, 0.005
PER_METRE = 1.0  # of progress along the lumen; published as 0.001 a millimetre
TRAINING_STEPS, TEST_STEPS = 150, 450  # 20 s and 60 s


# seeds of each type's arches; those of tests are never trained on
TRAINING_SEEDS: tuple[int, ...] = tuple(range(100))
TEST_SEEDS: tuple[int, ...] = tuple(range(10_000, 10_100))
PLACEHOLDER = "lcca"  # a target that every arch has, before an episode draws its own


@settings
class ArchVarietyTask(NavigationTask):
    """The tip within 5 mm of the target in a straight line; the published reward.

    The reward of a step is 1 at the target, plus 1 per metre of progress along the lumen, less 0.005, and less what
    `force_penalty` and `path_penalty` take, which are 0 by default.
    """

    success_radius: Annotated[float, Interval(gt=0, le=NEAR), Unit("m")] = 0.005
    success: Literal["lumen", "straight"] = "straight"  # as published
    max_steps: Count = TEST_STEPS

    def step_reward(
        self, distance: float, progress: float, force: float, moved: float = 0.0, *, success: bool
    ) -> float:
        """Reward of one step; arguments as of `NavigationTask.step_reward`."""
        reward = (AT_TARGET if success else 0.0) + PER_METRE * progress - STEP_COST
        return self.penalised(reward, force, moved)


class ArchVarietyEnv(NavigateManyEnv):
    """A J wire is fed into an arch of one of six branching types, a new one each episode, to a random point.

    The target is a random point on the centrelines of all branches of the aorta, each as likely; it is reached within
    5 mm. Actions are the feeder's translation, at most 35 mm/s, and rotation, at most 180 degrees/s, 7.5 times a
    second. `info` also holds `case`, `phantom` (its name tells type and seed) and `target`.

    Observation by default `tracking`: `Box(16,)`, three points of the wire 2 mm apart in a view that is turned by 25
    degrees, now and a step ago (12), the target there (2), and the last action (2). Reward and endings are those of
    `ArchVarietyTask`.

    Args:
        arch_types: of "I", "II", "IV", "V", "VI", "VII".
        seeds: of the arches, each in every type.
        wires: as of `NavigateManyEnv`; None: a catheter alone, with `catheter`.
        observation, pace: as of `NavigateEnv`.
        resolution: m between the nodes of the arches' grids.
        task: its fields as further keywords replace its own.
        arguments: of `NavigateEnv`, for every episode: `catheter` among them.

    Raises:
        ValueError: a type or seed that there is not.
    """

    def __init__(
        self,
        arch_types: Sequence[str] = ARCH_TYPES,
        seeds: Sequence[int] = TRAINING_SEEDS,
        *,
        wires: Sequence[str | Guidewire | None] = ("arch_variety",),
        observation: str | Sequence[str] = "tracking",
        pace: str | Pace = "arch_variety",
        resolution: float = 1e-3,
        task: NavigationTask | None = None,
        **arguments: Any,
    ) -> None:
        unknown = [kind for kind in arch_types if kind not in ARCH_TYPES]
        if unknown or isinstance(arch_types, str):
            raise ValueError(f"arch_types must list some of {', '.join(ARCH_TYPES)}, got {arch_types!r}")
        for name in ("phantoms", "targets"):
            if name in arguments:
                raise ValueError(f"ArchVariety draws its {name}: leave {name} out")
        super().__init__(
            [(f"{VARIETY}_{kind}", seed) for kind in arch_types for seed in seeds],
            (PLACEHOLDER,),
            wires,
            resolution=resolution,
            observation=observation,
            pace=pace,
            task=ArchVarietyTask() if task is None else task,
            **arguments,
        )

    def _drawn_target(self) -> Point:
        points = points_beyond_root(self.phantom.tree, self.phantom.grid)
        drawn = as_target(points[int(self.np_random.integers(len(points)))])
        assert not isinstance(drawn, str)
        return drawn


class ThreadedArchVarietyVectorEnv(ThreadedVectorEnv):
    """A `ThreadedVectorEnv` of `ArchVarietyEnv`; arguments are those of both."""

    _make = ArchVarietyEnv
