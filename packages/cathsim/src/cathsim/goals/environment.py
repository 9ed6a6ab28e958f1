"""The goal-conditioned environment: each episode draws a goal, and observations name the goal reached and wanted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.entry import EntryLike
from cathsim.anatomy.point_target import Point, TargetLike, as_target, points_beyond_root
from cathsim.devices.arena import PROTRUSION
from cathsim.environment import NavigateEnv
from cathsim.goals.task import GoalTask, Infos
from cathsim.navigation import Arrival, NavigationTask, require_reach
from cathsim.observations.observables import GUIDANCE
from cathsim.registration.description import from_spec, resolve_argument
from cathsim.vector import ThreadedVectorEnv

_GOAL_DRAWS = 0x60A1  # beside an episode's seed, so that the draw of its goal leaves those of its start as they are


class NavigateGoalEnv(NavigateEnv):
    """`NavigateEnv` towards a goal that each reset draws, for learners that relabel goals.

    ## Observations
    `Dict`, float32 where `observation` is no image

    | key | what | shape | unit |
    |---|---|---|---|
    | observation | the observables of `observation`, one after the other | (n,) | SI |
    | achieved_goal | the tip | (3,) float64 | m, world |
    | desired_goal | the goal | (3,) float64 | m, world |

    Where the vessel breathes, both goals are in the frame that moves with it.

    ## Reward
    That of `GoalTask`: "sparse", 0 within `success_radius` of the goal and else -1; "dense", minus the distance, m; or
    a function of achieved goals, desired goals and infos. `compute_reward` gives it for any goal.

    Actions, endings and info are those of `NavigateEnv`; `info["is_success"]` repeats `success`.

    Args:
        phantom: as of `NavigateEnv`.
        goals: names of targets, or points in the lumen, (3,) m each, one of which a reset draws, each as likely; None:
            the points of all branches' centrelines that the wire can reach. `reset(options={"target": …})` gives one.
        observation: names of observables; those that depend on the target are refused. An image only alone.
        task: a `GoalTask`; its fields as further keywords replace the task's.
        arguments: as of `NavigateEnv`.

    Raises:
        ValueError: no goal to choose from, one out of reach, or an observation that depends on the target.
    """

    def __init__(
        self,
        phantom: str | Phantom = "type_1",
        goals: Sequence[TargetLike] | None = None,
        *,
        observation: str | Sequence[str] = ("joints", "feeder"),
        task: NavigationTask | None = None,
        **arguments: Any,
    ) -> None:
        if "target" in arguments:
            raise ValueError("a goal-conditioned environment takes goals, a list, instead of a target")
        names = [observation] if isinstance(observation, str) else list(observation)
        guiding = [name for name in names if name in GUIDANCE]
        if guiding:
            raise ValueError(
                f"observation {', '.join(guiding)} depends on the target, which no learner can relabel: leave it out"
            )
        if goals is not None and (isinstance(goals, str) or not len(goals)):
            raise ValueError(f"goals must list at least one name or point, got {goals!r}")
        phantom = resolve_argument(
            "phantom", phantom, Phantom, partial(load_phantom, seed=arguments.pop("phantom_seed", None))
        )
        entry = arguments.get("entry", "descending")
        ways = centreline_goals(phantom, entry) if goals is None else {}
        targets = list(ways) if goals is None else [as_target(goal) for goal in goals]
        task = GoalTask() if task is None else from_spec(task)
        if not isinstance(task, GoalTask):
            raise ValueError(f"task must be a GoalTask, got {task!r}")
        if arguments.get("observe_every", 1) != 1:
            raise ValueError("observe_every must be 1: a goal that is kept from an earlier step has another reward")
        super().__init__(phantom, targets[0], observation=names, task=task, **arguments)
        if goals is None:
            reach = self.simulation.max_insertion + PROTRUSION + self.task.success_radius
            targets = [goal for goal, way in ways.items() if way <= reach]
        for goal in targets if goals is not None else ():
            require_reach(dataclasses.replace(self.task, target=goal), self.simulation)
        self.goals = tuple(targets)
        assert isinstance(self.sensors.space, gymnasium.spaces.Dict)  # as the names were given in a list
        parts = self.sensors.space.spaces
        flat = all(space.dtype == np.float32 for space in parts.values())
        if not flat and len(parts) > 1:
            raise ValueError(f"an image can only be observed alone beside the goals, got {', '.join(names)}")
        size = sum(math.prod(space.shape or ()) for space in parts.values())
        place = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32) if flat else parts[names[0]]
        self._flat = flat
        self.observation_space = gymnasium.spaces.Dict(
            {"observation": seen, "achieved_goal": place, "desired_goal": place}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode towards a goal drawn from `goals`.

        Args:
            seed: of the goal and of the start's jitter.
            options: as of `NavigateEnv.reset`; with `target`, no goal is drawn.
        """
        options = dict(options or {})
        if options.get("target") is None:
            generator = self.np_random if seed is None else np.random.default_rng((_GOAL_DRAWS, seed))
            options["target"] = self.goals[int(generator.integers(len(self.goals)))]
        return super().reset(seed=seed, options=options)

    def observe(self) -> dict[str, NDArray[Any]]:
        """The observation of the moment."""
        parts = list(self.sensors.observe().values())
        seen = np.concatenate([part.ravel() for part in parts]) if self._flat else parts[0]
        place = np.array(self.simulation.tip_in_vessel, np.float64)
        return {"observation": seen, "achieved_goal": place, "desired_goal": self.goal}

    def compute_reward(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Infos
    ) -> float | NDArray[np.float64]:
        """Rewards of places for goals, one or many; that of the last step for its own goals.

        Args:
            achieved_goal: shape (3,) or (n, 3), m.
            desired_goal: of the same shape.
            info: of the step, or of each; read where there is a `force_penalty`.

        Returns:
            A number, or shape (n,).
        """
        task = self.task
        assert isinstance(task, GoalTask)
        reward = task.goal_reward(achieved_goal, desired_goal, info)
        return float(reward) if reward.ndim == 0 else reward

    def _reward(self, before_step: np.ndarray, action: np.ndarray, info: dict[str, Any]) -> float:
        reward = self.compute_reward(np.array(self.simulation.tip_in_vessel), self.goal, info)
        assert isinstance(reward, float)
        return reward

    def _info(self, tip: np.ndarray, arrival: Arrival, *, success: bool, invalid: bool) -> dict[str, Any]:
        info = super()._info(tip, arrival, success=success, invalid=invalid)
        return {**info, "is_success": success}


def centreline_goals(phantom: Phantom, entry: EntryLike = "descending") -> dict[str | Point, float]:
    """Points on the centrelines of all branches, m, world frame.

    Returns:
        The way from the entry to each, m, the shortest first.

    Raises:
        ValueError: the phantom has no branches.
    """
    points = [as_target(point) for point in points_beyond_root(phantom.tree, phantom.grid)]
    if not points:
        raise ValueError(f"{phantom.name} has no branches to draw goals from: list goals, points in its lumen")
    ways = {point: phantom.way_length(point, entry) for point in points}
    return dict(sorted(ways.items(), key=lambda way: way[1]))


class ThreadedGoalVectorEnv(ThreadedVectorEnv):
    """A `ThreadedVectorEnv` of `NavigateGoalEnv`; arguments are those of both."""

    _make = NavigateGoalEnv
