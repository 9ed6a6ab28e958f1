"""The sampling expert: model-predictive control by the cross-entropy method on roll-outs of the simulator itself."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, TypeVar

import numpy as np
from annotated_types import Interval

from cathsim.devices.simulation import DualSimulation
from cathsim.environment import NavigateEnv
from cathsim.navigation import NavigationTask
from cathsim.planning.manoeuvres import Ending, Manoeuvre, retreat, search_manoeuvres
from cathsim.planning.primitives import motion_primitives, wire_advances
from cathsim.presets import ACCURACY, Accuracy
from cathsim.simulation import Simulation
from cathsim.validation import Count, Unit, settings

_Steps = Annotated[int, Interval(ge=1, le=10_000)]
_Result = TypeVar("_Result")


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
    most_force: Annotated[float, Interval(ge=0, le=1000), Unit("N")] = 1000.0
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


STUCK = 0.004  # m: a plan that gains less is none
TWO_DEVICES = ExpertSettings(samples=32, elites=6, primitives=True, confirm=4, patience=4, most_force=2.0)
_REFUTED = 1.0  # m, cost of a plan that is not confirmed, or not valid
_PASSED = 0.015  # m: a wire that is fed and is so much further from the target than it was gets no nearer
_RETREATS = 8  # that are drawn, until one stays below the largest force


class SamplingExpert:
    """Steers a wire, or a wire and a catheter, to the target by looking ahead in copies of the simulation.

    A plan's cost is the distance along the lumen that is left at its end, plus its contact forces; reaching the target
    early costs least. As long as the plan in hand still advances nearly as fast as the feeder can, no search is made.

    With `confirm`, a plan that reaches the target in the copies' coarser time steps is believed, and then carried out
    to its end, only when it does so in the environment's own. With `patience`, a tip that gets no nearer is taken to
    be in a local minimum of that distance. Manoeuvres are then searched, in which wire and catheter are brought to
    another lead, turned and drawn back, and the wire is fed again; the one whose tip comes nearest is carried out.
    Where none gains anything, all is drawn back and turned at random, and the search begins again from there.

    Args:
        environment: to be steered; its state is only read.
        settings: by default `TWO_DEVICES` with a catheter.
        seed: of the sampling; the same seed gives the same actions, whatever the number of threads.
        threads: by default one a core.

    Attributes:
        rollouts: plans that were tried so far.
        escapes: manoeuvres and retreats that were carried out so far to leave a local minimum.
    """

    def __init__(
        self,
        environment: NavigateEnv,
        *,
        seed: int = 0,
        settings: ExpertSettings | None = None,
        numerics: Accuracy = ACCURACY["fast"],
        threads: int | None = None,
    ) -> None:
        real = environment.simulation
        if real.motors:
            raise ValueError(
                "the sampling expert steers the actions of the feeders: make the environment with actions='feeder'"
            )
        both = isinstance(real, DualSimulation) and real.pair.both
        self.settings = settings or (TWO_DEVICES if both else ExpertSettings())
        self.environment, self._pace = environment, real.pace
        self._actions = 4 if both else 2
        self._goal = environment.goal
        self._generator = np.random.default_rng(seed)
        count = threads or os.cpu_count() or 1
        self._copies = [real.stepped_by(numerics) for _ in range(count)]
        self._own = real.stepped_by(real.numerics) if self.settings.confirm else None
        self._pool = ThreadPoolExecutor(count, "expert") if count > 1 else None
        self._plan = np.zeros((0, self._actions))
        self._left = 0
        self._nearest, self._waited = np.inf, 0
        self.rollouts = self.escapes = 0

    @property
    def task(self) -> NavigationTask:
        """The environment's, of the episode."""
        return self.environment.task

    def restart(self, seed: int | None = None) -> None:
        """Forgets the plan; to be called when the environment is reset."""
        self._plan, self._left = np.zeros((0, self._actions)), 0
        self._nearest, self._waited = np.inf, 0
        if seed is not None:
            self._generator = np.random.default_rng(seed)

    def action(self) -> np.ndarray:
        """The next action for the environment's present state. Shape (2,), with two devices (4,), in [-1, 1]."""
        if self._left == 0:
            self._left = self.settings.execute
            self._search()
        action, self._plan = self._plan[0], self._plan[1:]
        self._left -= 1
        return action.astype(np.float32)

    def _search(self) -> None:
        settings, generator = self.settings, self._generator
        simulation = self.environment.simulation
        state, self._goal = simulation.state(), self.environment.goal
        here = self.task.remaining(self.environment.phantom, simulation.tip_in_vessel)
        if self._stalled(here):
            self._leave_minimum(state, here)
            return
        knots = -(-settings.horizon // settings.hold)
        straight = np.tile([1.0, 0.0] * (self._actions // 2), (settings.horizon, 1))
        kept = np.concatenate((self._plan, straight))[: settings.horizon]
        candidates = np.stack((kept, straight))
        if settings.primitives:
            candidates = np.concatenate((candidates, motion_primitives(self._actions, settings.horizon)))
        costs = self._costs(state, candidates)
        best = int(np.argmin(costs))
        self._plan, cost = candidates[best], float(costs[best])
        if self._commits(cost):
            return
        good = here - 0.85 * self._pace.translation * settings.horizon
        if cost <= good:
            return

        mean = self._plan[:: settings.hold] if settings.primitives else np.tile([0.6, 0.0], (knots, 1))
        spread = np.tile([0.7, 0.9] * (self._actions // 2), (knots, 1))
        for _ in range(settings.rounds):
            draws = np.clip(generator.normal(mean, spread, (settings.samples, knots, self._actions)), -1.0, 1.0)
            plans = np.repeat(draws, settings.hold, axis=1)[:, : settings.horizon]
            costs = self._costs(state, plans)
            order = np.argsort(costs, kind="stable")[: settings.elites]
            if costs[order[0]] < cost:
                self._plan, cost = plans[order[0]], float(costs[order[0]])
            if self._commits(cost):
                return
            if cost <= good:
                break
            mean = draws[order].mean(0)
            spread = 0.1 + 0.9 * draws[order].std(0)
        if settings.primitives and isinstance(simulation, DualSimulation) and cost > here - STUCK:
            self._advance_wire(simulation, state, cost)

    def _advance_wire(self, simulation: DualSimulation, state: np.ndarray, cost: float) -> None:
        """Takes a plan that brings the wire out of the catheter, where one ends nearer to the target."""
        plans = wire_advances(simulation.device_lead, self._pace.translation)
        costs = self._costs(state, plans)
        if len(plans) and costs.min() < cost:
            self._plan = plans[int(np.argmin(costs))]
            self._left = len(self._plan)

    def _commits(self, cost: float) -> bool:
        """Carries a plan out to its end that is confirmed to reach the target."""
        if self._own is not None and cost < 0:
            self._left = len(self._plan)
        return self._own is not None and cost < 0

    def _stalled(self, here: float) -> bool:
        """Whether the tip, `here` m from the target, has come no nearer for `patience` decisions."""
        if here < self._nearest - STUCK:
            self._nearest, self._waited = here, 0
            return False
        self._waited += 1
        return 0 < self.settings.patience <= self._waited

    def _leave_minimum(self, state: np.ndarray, here: float) -> None:
        """Plans the manoeuvre that brings the tip nearest to the target, or a retreat where none brings it nearer."""
        simulation = self.environment.simulation
        lead = simulation.device_lead if isinstance(simulation, DualSimulation) else 0.0

        def evaluate(manoeuvres: Sequence[Manoeuvre]) -> list[Ending]:
            return self._each(lambda copy, index: self._ending(copy, state, manoeuvres[index]), len(manoeuvres))

        found = search_manoeuvres(evaluate, self._generator, self._actions, self._pace, lead=lead)
        self._waited = 0
        for (cost, steps), tried in found[: max(self.settings.confirm, 1)]:
            if self._own is not None:
                cost, steps = self._ending(self._own, state, tried)
                self.rollouts += 1
            if cost < min(self._nearest, here) - STUCK:
                self._plan = tried.plan[:steps]
                break
        else:
            self._plan, self._nearest = self._gentle_retreat(state, lead), np.inf
        self._left = len(self._plan)
        self.escapes += 1

    def _gentle_retreat(self, state: np.ndarray, lead: float) -> np.ndarray:
        """The first random retreat that stays below the largest force, else the one of the least."""
        plans: list[np.ndarray] = []
        forces: list[float] = []
        for _ in range(_RETREATS):
            plans.append(retreat(self._generator, self._actions, self._pace, lead=lead))
            forces.append(self._largest_force(self._copies[0], state, plans[-1]))
            self.rollouts += 1
            if forces[-1] <= self.settings.most_force:
                break
        return plans[int(np.argmin(forces))]

    def _largest_force(self, copy: Simulation, state: np.ndarray, plan: np.ndarray) -> float:
        """Largest contact force of a plan, N; infinite where it is not valid."""
        copy.restore(state)
        largest = 0.0
        for action in plan.tolist():
            self._advance(copy, action)
            if not copy.valid:
                return np.inf
            largest = max(largest, copy.summary.force_max)
        return largest

    def _costs(self, state: np.ndarray, plans: np.ndarray) -> np.ndarray:
        """Costs of plans (n, horizon, actions) from a state, in metres. Shape (n,)."""
        costs = np.array(self._each(lambda copy, index: self._cost(copy, state, plans[index]), len(plans)), np.float64)
        if self._own is not None:
            for number, index in enumerate(np.argsort(costs, kind="stable")[: np.count_nonzero(costs < 0)]):
                if number >= self.settings.confirm:
                    costs[index] = _REFUTED
                    continue
                costs[index] = self._cost(self._own, state, plans[index])
                self.rollouts += 1
        return costs

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

    def _ending(self, copy: Simulation, state: np.ndarray, tried: Manoeuvre) -> Ending:
        """Least cost of a manoeuvre while its wire is fed, in metres, and after how many steps."""
        settings = self.settings
        copy.restore(state)
        force, nearest, best = 0.0, np.inf, (_REFUTED, len(tried.plan))
        for step, action in enumerate(tried.plan.tolist()):
            self._advance(copy, action)
            if not copy.valid or copy.summary.force_max > settings.most_force:
                break
            force += max(copy.summary.force_max - settings.free_force, 0.0) / len(tried.plan)
            if self._reached(copy):
                return -1.0 + 0.001 * step + settings.force_cost * force, step + 1
            if step >= tried.fed_from:
                remaining = self._remaining(copy)
                nearest = min(nearest, remaining)
                best = min(best, (remaining + settings.force_cost * force, step + 1))
                if remaining > nearest + _PASSED:
                    break
        return best

    def _advance(self, copy: Simulation, action: Sequence[float]) -> None:
        pace, (translation, rotation, *catheter) = self._pace, action
        if catheter:
            assert isinstance(copy, DualSimulation)
            along = pace.translation * catheter[0], pace.rotation * catheter[1]
            copy.advance(pace.translation * translation, pace.rotation * rotation, catheter=along)
        else:
            copy.advance(pace.translation * translation, pace.rotation * rotation)

    def _reached(self, copy: Simulation) -> bool:
        return bool(np.linalg.norm(copy.tip_in_vessel - self._goal) < 0.9 * self.task.success_radius)

    def _remaining(self, copy: Simulation) -> float:
        return self.task.remaining(self.environment.phantom, copy.tip_in_vessel)

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None:
            self._pool.shutdown()
