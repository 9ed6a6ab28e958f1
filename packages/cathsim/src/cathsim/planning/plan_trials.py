"""Trials of plans in copies of a simulation: what a plan costs, where a manoeuvre ends, what it presses with."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, TypeVar

import numpy as np
from annotated_types import Interval

from cathsim.contact.compliance import stiffest_wall
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import NavigateEnv
from cathsim.planning.manoeuvres import Ending, Manoeuvre
from cathsim.presets import Accuracy
from cathsim.simulation import Simulation
from cathsim.validation import Count, Unit, settings

_Steps = Annotated[int, Interval(ge=1, le=10_000)]


_Result = TypeVar("_Result")
_REFUTED = 1.0  # m, cost of a plan that is not confirmed, or not valid
_PASSED = 0.015  # m: a wire that is fed and is so much further from the target than it was gets no nearer


@settings
class ExpertSettings:
    """How the expert searches."""

    horizon: _Steps = 18  # length of a plan, control steps
    hold: _Steps = 3  # steps for which a sampled action is held
    execute: _Steps = 6  # steps of a plan that are carried out before it is looked at again
    samples: Count = 24  # plans a round
    elites: Count = 5  # best plans, to which the sampling distribution is fitted
    rounds: Annotated[int, Interval(ge=0, le=1000)] = 3  # of sampling at most
    # cost of a newton of contact force above `free_force`, in metres of distance to the target
    force_cost: Annotated[float, Interval(ge=0, le=1000), Unit("m/N")] = 0.004
    free_force: Annotated[float, Interval(ge=0, le=1000), Unit("N")] = 0.15  # N
    # contact force beyond which a plan costs a metre a newton, and a manoeuvre ends; the default is no limit
    most_force: Annotated[float, Interval(gt=0, le=1000), Unit("N")] = 1000.0
    # lead of the wire before the catheter beyond which a plan costs a metre a metre: a wire far ahead strays
    most_lead: Annotated[float, Interval(ge=0, le=10), Unit("m")] = 0.08
    primitives: bool = False  # tries the motions of an operator first, and samples around the best of them
    # plans said to reach the target, a search, that the environment's own time stepping has to confirm; 0: none
    confirm: Annotated[int, Interval(ge=0, le=1000)] = 0
    # decisions without progress after which a manoeuvre, or a retreat, leaves the local minimum; 0: never
    patience: Annotated[int, Interval(ge=0, le=10_000)] = 0

    def __post_init__(self) -> None:
        if self.elites > self.samples:
            raise ValueError(f"elites must lie in 1 to samples ({self.samples}), got {self.elites}")
        if self.hold > self.horizon or self.execute > self.horizon:
            raise ValueError(f"hold and execute must lie in 1 to the horizon ({self.horizon})")


TWO_DEVICES = ExpertSettings(samples=32, elites=6, primitives=True, confirm=4, patience=4, most_force=2.0)


class PlanTrials:
    """Carries plans out in copies of an environment's simulation, and tells what they cost.

    A plan's cost, in metres, is the distance along the lumen that is left at its end, plus its contact forces. It is
    negative where the target is reached. Plans are tried in coarser time steps; with `confirm` those that reach the
    target are tried once more in the environment's own.

    Args:
        environment: whose state is only read.
        settings: with the costs of forces and of a wire far ahead, and `confirm`.
        numerics: time steps of the copies.
        threads: at least 1; None: one a core.

    Attributes:
        confirming: a copy in the environment's own time steps; None: nothing is to be confirmed.
        rollouts: plans that were tried so far.
    """

    def __init__(
        self, environment: NavigateEnv, settings: ExpertSettings, numerics: Accuracy, threads: int | None = None
    ) -> None:
        real = environment.simulation
        self.settings, self._environment, self._pace = settings, environment, real.pace
        count = threads or os.cpu_count() or 1
        self._copies = [_stepped_by(real, numerics) for _ in range(count)]
        self.confirming = _stepped_by(real, real.numerics) if settings.confirm else None
        self._pool = ThreadPoolExecutor(count, "expert") if count > 1 else None
        self.rollouts = 0
        self._steps: Counter[int] = Counter()  # of each copy, which one thread at a time steps

    @property
    def steps(self) -> int:
        """Control steps that all plans took so far."""
        return self._steps.total()

    def costs(self, state: np.ndarray, plans: np.ndarray) -> np.ndarray:
        """Costs of plans (n, horizon, actions) from a state, in metres. Shape (n,)."""
        costs = np.array(self._each(lambda copy, index: self._cost(copy, state, plans[index]), len(plans)), np.float64)
        if self.confirming is not None:
            for number, index in enumerate(np.argsort(costs, kind="stable")[: np.count_nonzero(costs < 0)]):
                if number >= self.settings.confirm:
                    costs[index] = _REFUTED
                    continue
                costs[index] = self._cost(self.confirming, state, plans[index])
                self.rollouts += 1
        return costs

    def endings(self, state: np.ndarray, manoeuvres: Sequence[Manoeuvre]) -> list[Ending]:
        """Of each manoeuvre from a state, the least cost while its wire is fed, in metres, and after how many steps."""
        return self._each(lambda copy, index: self._ending(copy, state, manoeuvres[index]), len(manoeuvres))

    def confirmed(self, state: np.ndarray, tried: Manoeuvre, ending: Ending) -> Ending:
        """The ending in the environment's own time steps; without `confirm` the one that was found."""
        if self.confirming is None:
            return ending
        self.rollouts += 1
        return self._ending(self.confirming, state, tried)

    def largest_force(self, state: np.ndarray, plan: np.ndarray) -> float:
        """Largest contact force of a plan (n, actions), N; infinite where it is not valid."""
        copy, largest = self._copies[0], 0.0
        copy.restore(state)
        self.rollouts += 1
        for action in plan.tolist():
            self._advance(copy, action)
            if not copy.valid:
                return np.inf
            largest = max(largest, copy.summary.force_max)
        return largest

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _each(self, run: Callable[[Simulation, int], _Result], count: int) -> list[_Result]:
        """What `run` returns for each index below `count`, in copies of the simulation."""
        results: dict[int, _Result] = {}
        order = itertools.count()

        def work(copy: Simulation) -> None:
            while (index := next(order)) < count:
                results[index] = run(copy, index)

        if self._pool is None:
            work(self._copies[0])
        else:
            for future in [self._pool.submit(work, copy) for copy in self._copies]:
                future.result()
        self.rollouts += count
        return [results[index] for index in range(count)]

    def _cost(self, copy: Simulation, state: np.ndarray, plan: np.ndarray) -> float:
        settings = self.settings
        copy.restore(state)
        force = excess = 0.0
        for step, action in enumerate(plan.tolist()):
            self._advance(copy, action)
            if not copy.valid:
                return _REFUTED
            force += max(copy.summary.force_max - settings.free_force, 0.0) / len(plan)
            excess = max(excess, copy.summary.force_max - settings.most_force)
            if self._reached(copy) and excess == 0.0:
                return -1.0 + 0.01 * step + settings.force_cost * force
        strayed = max(copy.device_lead - settings.most_lead, 0.0) if isinstance(copy, DualSimulation) else 0.0
        return self._remaining(copy) + settings.force_cost * force + strayed + excess

    def _ending(self, copy: Simulation, state: np.ndarray, manoeuvre: Manoeuvre) -> Ending:
        settings = self.settings
        copy.restore(state)
        force, nearest, best = 0.0, np.inf, (_REFUTED, len(manoeuvre.plan))
        for step, action in enumerate(manoeuvre.plan.tolist()):
            self._advance(copy, action)
            if not copy.valid or copy.summary.force_max > settings.most_force:
                break
            force += max(copy.summary.force_max - settings.free_force, 0.0) / len(manoeuvre.plan)
            if self._reached(copy):
                return -1.0 + 0.001 * step + settings.force_cost * force, step + 1
            if step >= manoeuvre.fed_from:
                remaining = self._remaining(copy)
                nearest = min(nearest, remaining)
                best = min(best, (remaining + settings.force_cost * force, step + 1))
                if remaining > nearest + _PASSED:
                    break
        return best

    def _advance(self, copy: Simulation, action: Sequence[float]) -> None:
        pace, (translation, rotation, *catheter) = self._pace, action
        self._steps[id(copy)] += 1
        if catheter:
            assert isinstance(copy, DualSimulation)
            along = pace.translation * catheter[0], pace.rotation * catheter[1]
            copy.advance(pace.translation * translation, pace.rotation * rotation, catheter=along)
        else:
            copy.advance(pace.translation * translation, pace.rotation * rotation)

    def _reached(self, copy: Simulation) -> bool:
        return self._environment.arrival(copy.tip_in_vessel, 0.9).success

    def _remaining(self, copy: Simulation) -> float:
        return self._environment.task.remaining(self._environment.phantom, copy.tip_in_vessel)


def _stepped_by(real: Simulation, numerics: Accuracy) -> Simulation:
    """Another simulation of the same devices in the same vessel, with another time stepping, at its start.

    A wall that is too stiff for the timestep is taken as stiff as it can be; penetration is not measured.
    """
    (phantom, devices, _), keywords = real.arguments()
    if real.wall_stiffness is not None:
        keywords["wall_stiffness"] = min(real.wall_stiffness, stiffest_wall(numerics))
    return type(real)(phantom, devices, numerics, **keywords | {"measure_penetration": False})
