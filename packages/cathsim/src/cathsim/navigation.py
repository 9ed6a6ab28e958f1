"""The task: bring the wire's tip to a target; start, reward, ending."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Interval
from pydantic import BeforeValidator

from cathsim.anatomy import Phantom
from cathsim.anatomy.point_target import Place, Point, TargetLike, as_target, target_name
from cathsim.devices.arena import PROTRUSION, max_insertion
from cathsim.devices.pair import DevicePair
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.simulation import Simulation
from cathsim.validation import Count, Turn, Unit, check_fields, settings

REWARDS = ("distance", "geodesic")
OWN = "own:"  # before the name of a reward that is not in REWARDS
OwnReward = Callable[..., Any]
SUCCESS_REWARD = 10.0
POTENTIAL_PER_METRE = 100.0  # of the geodesic reward
STEP_COST = 0.02  # of the geodesic reward
NEAR = 0.5  # m: success radii and jitters beyond it were meant in another unit
WAY_MARGIN = 0.02  # a wire needs this much more than the shortest way, m: it cuts no corners


def _as_reward(reward: object) -> object:
    if isinstance(reward, str) or callable(reward):
        return reward
    raise ValueError(f"reward must be a name, {' or '.join(REWARDS)}, or a function, got {reward!r}")


Reward = Annotated[str | OwnReward, BeforeValidator(_as_reward)]


@settings
class NavigationTask:
    """What an episode asks for.

    A subclass may have a reward of its own: its `step_reward` is given the progress along the lumen and the tip's way
    in every step, whatever `reward` says. So may a task without one: `reward` may be a function.

    Attributes:
        target: name of one of the phantom's targets, or a point in the lumen, m, world frame.
        success_radius: the target is reached within this distance of the tip, m.
        success: "lumen": the tip is in the target's branch, or in one that leaves it further on, and the distance is
            also measured along the centrelines; "straight": the Euclidean distance alone, the thesis's, which can be
            reached through a wall.
        max_steps: an episode is truncated after this many control steps.
        start_jitter: the wire starts advanced by 0 to this much, uniformly, m.
        start_rotation: each feeder starts turned by up to this much either way, uniformly, rad.
        reward: "distance", the thesis's: minus the Euclidean distance to the target in metres; or "geodesic": the
            decrease of the distance along the lumen times 100 per metre, less 0.02 a step. Both give 10 at the target.
            Or a function that takes the step's `info`, in which there are also `progress` (m, decrease of the distance
            along the lumen), `moved` (m, of the tip in the step) and `action`, and returns a number.
        force_penalty: subtracted per newton by which the step's largest resultant contact force exceeds
            `force_threshold`.
        force_threshold: contact force that costs nothing, N.
        path_penalty: subtracted per metre that the tip moves in a step.

    Source: thesis, chapter CathSim, "Actions and Rewards".
    """

    target: Annotated[str | Point, BeforeValidator(as_target)] = "bca"
    success_radius: Annotated[float, Interval(gt=0, le=NEAR), Unit("m")] = 0.008
    success: Literal["lumen", "straight"] = "lumen"
    max_steps: Count = 300
    start_jitter: Annotated[float, Interval(ge=0, le=NEAR), Unit("m")] = 0.001
    start_rotation: Turn = 0.0
    reward: Reward = "distance"
    force_penalty: Annotated[float, Interval(ge=0, le=1e4), Unit("1/N")] = 0.0
    force_threshold: Annotated[float, Interval(ge=0, le=1e4), Unit("N")] = 0.0
    path_penalty: Annotated[float, Interval(ge=0, le=1e4), Unit("1/m")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, NavigationTask)
        names = self.reward_names()
        if isinstance(self.reward, str) and self.reward not in names:
            raise ValueError(f"unknown reward '{self.reward}'; there are {', '.join(names)}, or give a function")

    @classmethod
    def reward_names(cls) -> tuple[str, ...]:
        """The rewards that have a name."""
        return REWARDS

    @property
    def target_name(self) -> str:
        """The target's name, also where it is a point."""
        return target_name(self.target)

    @property
    def reads_progress(self) -> bool:
        """Whether the reward depends on the progress along the lumen; a subclass's own may."""
        own = type(self)
        overridden = own.step_reward is not NavigationTask.step_reward or own.remaining is not NavigationTask.remaining
        return self.reward == "geodesic" or callable(self.reward) or overridden

    def draw_start(self, generator: np.random.Generator) -> tuple[float, float]:
        """Insertion (m) and rotation (rad) at the start of an episode."""
        insertion = generator.uniform(0.0, self.start_jitter) if self.start_jitter else 0.0
        rotation = generator.uniform(-self.start_rotation, self.start_rotation) if self.start_rotation else 0.0
        return insertion, rotation

    def start(self, simulation: Simulation, generator: np.random.Generator) -> None:
        """Puts the devices at the start of an episode: of two, the catheter is not advanced, and turned by its own.

        Where the vessel breathes, the episode begins anywhere in a breath.
        """
        start = self.draw_start(generator)
        breathing, pair = simulation.breathing, isinstance(simulation, DualSimulation)
        devices = self.draw_devices(start, simulation.pair, generator) if pair else None  # type: ignore[attr-defined]
        time = 0.0 if breathing is None else float(generator.uniform(0.0, breathing.period))
        if devices is not None:
            simulation.reset(*devices[:2], catheter=devices[2], time=time)  # type: ignore[call-arg]
        else:
            simulation.reset(*start, time=time)

    def draw_devices(
        self, start: tuple[float, float], pair: DevicePair, generator: np.random.Generator
    ) -> tuple[float, float, tuple[float, float]]:
        """The start with a catheter: insertion (m) and rotation (rad) of `start`, and those of the catheter.

        It is advanced only where the wire's lead has a limit, and turned by its own; alone, it is what `start` says.
        """
        if not pair.both:
            return (*start, start)
        return (*start, (max(start[0] - pair.most_ahead, 0.0), self.draw_start(generator)[1]))

    def goal(self, phantom: Phantom) -> np.ndarray:
        """Position of the target, m. Shape (3,)."""
        return phantom.target(self.target).position

    def step_reward(
        self, distance: float, progress: float, force: float, moved: float = 0.0, *, success: bool
    ) -> float:
        """Reward of one step.

        Args:
            distance: from the tip to the target in a straight line, m.
            progress: decrease of the distance along the lumen in this step, m; 0 unless `reads_progress`.
            force: largest resultant contact force of the step, N.
            moved: how far the tip has moved in this step, m.
        """
        if self.reward == "geodesic":
            reward = POTENTIAL_PER_METRE * progress - STEP_COST + (SUCCESS_REWARD if success else 0.0)
        else:
            reward = SUCCESS_REWARD if success else -distance
        return self.penalised(reward, force, moved)

    def penalised(self, reward: float, force: float, moved: float) -> float:
        """A reward less the penalties for a step's largest resultant contact force (N) and the tip's way in it (m)."""
        return reward - self.force_penalty * max(force - self.force_threshold, 0.0) - self.path_penalty * moved

    def reward_of(
        self, info: Mapping[str, Any], progress: float, moved: float, action: np.ndarray, *, success: bool
    ) -> float:
        """Reward of one step: what a function gives less the penalties, or `step_reward`.

        Args:
            info: of the step, with at least `distance` (m) and `force` (N).
            progress, moved: as of `step_reward`.
            action: clipped to -1 to 1.

        Raises:
            ValueError: the function has not given one finite number.
        """
        force = info["force"]
        if isinstance(self.reward, str):
            return self.step_reward(info["distance"], progress, force, moved, success=success)
        raw_reward = self.reward({**info, "progress": progress, "moved": moved, "action": action})
        value = np.asarray(raw_reward)
        if value.size != 1 or value.dtype.kind not in "biuf" or not np.isfinite(value).all():
            raise ValueError(f"a reward must be one finite number, {reward_name(self.reward)} gave {raw_reward!r}")
        return self.penalised(float(value.item()), force, moved)

    def remaining(self, phantom: Phantom, tip: np.ndarray) -> float:
        """Distance along the lumen from the tip to the target, m."""
        return float(phantom.geodesic_distance(tip, self.target))


class Arrival(NamedTuple):
    """Where a tip is, seen from a task's target.

    Attributes:
        place: branch and depth of the tip.
        distance: from the target in a straight line, m.
        success_lumen: whether it has reached the target by the rule "lumen".
        success: whether it has by the rule of the task.
    """

    place: Place
    distance: float
    success_lumen: bool
    success: bool

    def info(
        self, tip: np.ndarray, fed: Sequence[float], force: float, vector: np.ndarray, *, success: bool, invalid: bool
    ) -> dict[str, Any]:
        """What every step's `info` holds, as `NavigateEnv` describes it; `fed` are insertion (m) and rotation (rad)."""
        return {
            "tip": tip,
            "distance": self.distance,
            "branch": self.place.branch,
            "depth": self.place.depth,
            "insertion": fed[0],
            "rotation": fed[1],
            "force": force,
            "force_vector": vector,
            "success": success,
            "success_lumen": self.success_lumen and not invalid,
            "invalid": invalid,
        }


class Goal:
    """The target of a task in a phantom.

    Attributes:
        position: m, shape (3,).
        remaining: the way along the lumen that was left at the last call of `progress`, m.
    """

    def __init__(self, task: NavigationTask, phantom: Phantom, *, reads_way: bool = False) -> None:
        self.position, self.remaining = task.goal(phantom), 0.0
        self._task, self._phantom, self._depths = task, phantom, phantom.depths
        self._reads_way = reads_way or task.reads_progress
        self._hold_field()

    def _hold_field(self) -> None:
        # so that a point's field stays with the phantom while it is read
        self._field = self._phantom.geodesic_field(self._task.target) if self._reads_way else None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_field": None}  # the phantom has it

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._hold_field()

    @cached_property
    def _place(self) -> Place:
        return self._depths.place(self.position)

    def arrival(self, tip: np.ndarray, share: float = 1.0) -> Arrival:
        """Whether a tip (3,) m has arrived: within a share of the task's success radius."""
        radius = share * self._task.success_radius
        distance, place = straight_distance(tip, self.position), self._depths.place(tip)
        near = distance <= radius
        inside = near and self._depths.way(place, self._place) <= radius
        return Arrival(place, distance, inside, inside if self._task.success == "lumen" else near)

    def progress(self, tip: np.ndarray) -> float:
        """By how much the way from the tip (3,) m is shorter than at the last call, m; 0 where the task reads none."""
        before = self.remaining
        if self._task.reads_progress:
            self.remaining = self._task.remaining(self._phantom, tip)
        return before - self.remaining


def reward_name(reward: str | OwnReward) -> str:
    """What a reward is called; one that `NavigationTask` does not know by name begins with "own:".

    A function is called by the place of its definition, module:function.
    """
    if isinstance(reward, str):
        return reward if reward in REWARDS else OWN + reward
    kind: Any = reward if hasattr(reward, "__qualname__") else type(reward)
    return f"{OWN}{kind.__module__}:{kind.__qualname__}"


def straight_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Euclidean distance of two points (3,)."""
    x, y, z = (a - b).tolist()
    return float((x * x + y * y + z * z) ** 0.5)


def require_reach(task: NavigationTask, simulation: Simulation) -> None:
    """As `require_length` of a simulation's wire, or of the chain in which its devices lie."""
    alone = isinstance(simulation, DualSimulation) and simulation.pair.wire is None
    require_length(task, simulation.phantom, simulation.entry, simulation.wire, alone=alone)


def require_length(task: NavigationTask, phantom: Phantom, entry: str, wire: Guidewire, *, alone: bool) -> None:
    """Refuses a wire that is too short for the task's target, fed in all the way and on the shortest way.

    Args:
        alone: whether it is what a catheter without a wire is simulated over.

    Raises:
        ValueError: says how long a wire is needed.
    """
    reach = max_insertion(wire) + PROTRUSION + task.success_radius
    if phantom.way_length(task.target, entry) <= reach:
        return  # along the centrelines, which is quick to know and longer than the shortest way
    start = phantom.entry(entry).position
    shortest = float(phantom.geodesic_distance(start, task.target))
    if shortest > reach:
        lacking = shortest - reach + WAY_MARGIN
        length = math.ceil((wire.length + lacking) * 100 - 1e-9) / 100
        device = "catheter is simulated over" if alone else "wire of"
        verdict = "which is too short for" if alone else "is too short for"
        raise ValueError(
            f"the {device} {wire.length * 1e3:.0f} mm{',' if alone else ''} {verdict} {task.target_name} of "
            f"{phantom.name}, {shortest * 1e3:.0f} mm from {entry}, and must have {length * 1e3:.0f}: "
            f"pass wire=load_guidewire(...).scaled({length:.2f})"
        )


def navigation_task(
    target: TargetLike | None, fields: Mapping[str, Any], task: NavigationTask | None = None
) -> NavigationTask:
    """A task from an environment's keywords.

    Args:
        target: its target; None: the task's own.

    Raises:
        ValueError: a field that there is not.
    """
    if task is None:
        task = NavigationTask()
    elif not isinstance(task, NavigationTask):
        raise ValueError(f"task must be a NavigationTask, got {task!r}")
    known = [field.name for field in dataclasses.fields(task)]
    unknown = sorted(set(fields) - set(known))
    if unknown:
        raise ValueError(f"the environment has no argument {', '.join(unknown)}; the task's are {', '.join(known)}")
    changes = dict(fields) if target is None else {"target": target, **fields}
    return dataclasses.replace(task, **changes) if changes else task
