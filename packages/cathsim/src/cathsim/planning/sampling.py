"""The sampling expert: model-predictive control by the cross-entropy method on roll-outs of the simulator itself."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from cathsim.devices.simulation import DualSimulation
from cathsim.environment import NavigateEnv
from cathsim.planning.manoeuvres import retreat, search_manoeuvres
from cathsim.planning.plan_trials import TWO_DEVICES, ExpertSettings, PlanTrials
from cathsim.presets import ACCURACY

EMERGED, BEYOND = 0.010, 0.035  # m of wire in front of the catheter
_FIRST = 10  # steps in which the catheter is moved first, by these translations and rotations
_CATHETER_FIRST = ((0.0, 0.0), (0.0, 0.5), (0.0, -0.5), (0.0, 1.0), (-1.0, 0.0), (-1.0, 0.5), (-1.0, -0.5))
# Translation and rotation of the wire, or of wire and catheter, of the most in a step: first half, then second half.
_WIRE = (
    ((0, 1), (1, 0)),
    ((0, -1), (1, 0)),
    ((1, 0.5), (1, 0.5)),
    ((1, -0.5), (1, -0.5)),
    ((1, 1), (1, 1)),
    ((1, -1), (1, -1)),
    ((-1, 0), (-1, 0)),
    ((-1, 0.5), (1, 0.5)),
    ((-1, -0.5), (1, -0.5)),
    ((-1, 1), (1, 0)),
    ((-1, -1), (1, 0)),
)
_TWO_DEVICES = (
    ((1, 0, 0, 0), (1, 0, 0, 0)),  # the wire goes ahead
    ((1, 0.7, 0, 0), (1, 0.7, 0, 0)),
    ((1, -0.7, 0, 0), (1, -0.7, 0, 0)),
    ((0, 0, 1, 0), (0, 0, 1, 0)),  # the catheter follows over it
    ((-1, 0, 0, 0), (1, 0, 0, 0)),  # the wire is withdrawn, and fed again
    ((-1, 0, 1, 0), (-1, 0, 1, 0)),  # the catheter's shape returns
    ((0, 0, 0, 1), (1, 0, 0, 0)),  # the catheter is turned, then the wire goes ahead
    ((0, 0, 0, -1), (1, 0, 0, 0)),
    ((0, 0, 0, 0.7), (1, 0, 1, 0.7)),
    ((0, 0, 0, -0.7), (1, 0, 1, -0.7)),
    ((0, 0, -1, 0), (1, 0, 0, 0)),  # the catheter is withdrawn, as a reverse curve is to engage
    ((-1, 0, -1, 0), (1, 0, 0, 0)),  # both are withdrawn, then the wire goes ahead
    ((-1, 0, -1, 0.5), (1, 0, 0, 0)),
    ((-1, 0, -1, -0.5), (1, 0, 0, 0)),
)


STUCK = 0.004  # m: a plan that gains less is none
_RETREATS = 8  # that are drawn, until one stays below the largest force


def motion_primitives(actions: int, horizon: int) -> NDArray[np.float64]:
    """Plans of an operator's motions.

    Args:
        actions: 2 for the wire, 4 for wire and catheter.
        horizon: length of a plan, control steps.

    Returns:
        Shape (k, horizon, actions), shares of the largest movement in a step.
    """
    halves = np.array(_WIRE if actions == 2 else _TWO_DEVICES, np.float64)
    return np.repeat(halves, [horizon - horizon // 2, horizon // 2], axis=1)


def wire_advances(lead: float, step: float) -> NDArray[np.float64]:
    """Plans that bring the wire out of the catheter and on, which no plan of a few steps would see the end of.

    Args:
        lead: how far the wire is ahead of the catheter, m; from `EMERGED` on there are no plans.
        step: largest translation in a step, m.

    Returns:
        Shape (k, steps, 4): the catheter is turned, withdrawn, or not moved; then the wire goes `BEYOND` its tip.
    """
    firsts = _CATHETER_FIRST if lead < EMERGED else ()
    pushes = int(np.ceil((BEYOND - lead) / step)) if firsts else 0
    plans = np.zeros((len(firsts), _FIRST + pushes, 4))
    plans[:, _FIRST:, 0] = 1.0
    for plan, motion in zip(plans, firsts, strict=True):
        plan[:_FIRST, 2:] = motion
    return plans


class SamplingExpert:
    """Steers a wire, or a wire and a catheter, to the target by looking ahead in copies of the simulation.

    Plans cost what `PlanTrials` says; reaching the target early costs least. As long as the plan in hand still advances
    nearly as fast as the feeder can, no search is made.

    With `confirm`, a plan that reaches the target in the copies' coarser time steps is believed, and then carried out
    to its end, only when it does so in the environment's own. With `patience`, a tip that gets no nearer is taken to
    be in a local minimum of that distance. Manoeuvres are then searched, in which wire and catheter are brought to
    another lead, turned and withdrawn, and the wire is fed again; the one whose tip comes nearest is carried out.
    Where none gains anything, all is withdrawn and turned at random, and the search begins again from there.

    Args:
        environment: to be steered; its state is only read.
        settings: by default `TWO_DEVICES` with a catheter.
        seed: of the sampling; the same seed gives the same actions, whatever the number of threads.
        threads: by default one a core.

    Attributes:
        escapes: manoeuvres and retreats that were carried out so far to leave a local minimum.
    """

    def __init__(
        self,
        environment: NavigateEnv,
        *,
        seed: int = 0,
        settings: ExpertSettings | None = None,
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
        self._generator = np.random.default_rng(seed)
        self.trials = PlanTrials(environment, self.settings, ACCURACY["fast"], threads)
        self._plan = np.zeros((0, self._actions))
        self._left = 0
        self._nearest, self._waited = np.inf, 0
        self.escapes = 0

    @property
    def rollouts(self) -> int:
        """Plans that were tried so far."""
        return self.trials.rollouts

    @property
    def steps(self) -> int:
        """Control steps that all plans took so far, those of manoeuvres included."""
        return self.trials.steps

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
        state = simulation.state()
        remaining = self.environment.task.remaining(self.environment.phantom, simulation.tip_in_vessel)
        if self._stalled(remaining):
            self._leave_minimum(state, remaining)
            return
        knots = -(-settings.horizon // settings.hold)
        straight = np.tile([1.0, 0.0] * (self._actions // 2), (settings.horizon, 1))
        plan = np.concatenate((self._plan, straight))[: settings.horizon]
        candidates = np.stack((plan, straight))
        if settings.primitives:
            candidates = np.concatenate((candidates, motion_primitives(self._actions, settings.horizon)))
        costs = self.trials.costs(state, candidates)
        best = int(np.argmin(costs))
        self._plan, cost = candidates[best], float(costs[best])
        if self._commits(cost):
            return
        good = remaining - 0.85 * self._pace.translation * settings.horizon
        if cost <= good:
            return

        mean = self._plan[:: settings.hold] if settings.primitives else np.tile([0.6, 0.0], (knots, 1))
        spread = np.tile([0.7, 0.9] * (self._actions // 2), (knots, 1))
        for _ in range(settings.rounds):
            draws = np.clip(generator.normal(mean, spread, (settings.samples, knots, self._actions)), -1.0, 1.0)
            plans = np.repeat(draws, settings.hold, axis=1)[:, : settings.horizon]
            costs = self.trials.costs(state, plans)
            order = np.argsort(costs, kind="stable")[: settings.elites]
            if costs[order[0]] < cost:
                self._plan, cost = plans[order[0]], float(costs[order[0]])
            if self._commits(cost):
                return
            if cost <= good:
                break
            mean = draws[order].mean(0)
            spread = 0.1 + 0.9 * draws[order].std(0)
        if settings.primitives and isinstance(simulation, DualSimulation) and cost > remaining - STUCK:
            self._advance_wire(simulation, state, cost)

    def _advance_wire(self, simulation: DualSimulation, state: np.ndarray, cost: float) -> None:
        """Takes a plan that brings the wire out of the catheter, where one ends nearer to the target."""
        plans = wire_advances(simulation.device_lead, self._pace.translation)
        costs = self.trials.costs(state, plans)
        if len(plans) and costs.min() < cost:
            self._plan = plans[int(np.argmin(costs))]
            self._left = len(self._plan)

    def _commits(self, cost: float) -> bool:
        """Carries a plan out to its end that is confirmed to reach the target."""
        confirmed = self.trials.confirming is not None and cost < 0
        if confirmed:
            self._left = len(self._plan)
        return confirmed

    def _stalled(self, remaining: float) -> bool:
        """Whether the tip, `remaining` m from the target, has come no nearer for `patience` decisions."""
        if remaining < self._nearest - STUCK:
            self._nearest, self._waited = remaining, 0
            return False
        self._waited += 1
        return 0 < self.settings.patience <= self._waited

    def _leave_minimum(self, state: np.ndarray, remaining: float) -> None:
        """Plans the manoeuvre that brings the tip nearest to the target, or a retreat where none brings it nearer."""
        simulation = self.environment.simulation
        lead = simulation.device_lead if isinstance(simulation, DualSimulation) else 0.0
        evaluate = functools.partial(self.trials.endings, state)
        manoeuvre = search_manoeuvres(evaluate, self._generator, self._actions, self._pace, lead=lead)
        self._waited = 0
        for ending, candidate in manoeuvre[: max(self.settings.confirm, 1)]:
            cost, steps = self.trials.confirmed(state, candidate, ending)
            if cost < min(self._nearest, remaining) - STUCK:
                self._plan = candidate.plan[:steps]
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
            forces.append(self.trials.largest_force(state, plans[-1]))
            if forces[-1] <= self.settings.most_force:
                break
        return plans[int(np.argmin(forces))]

    def close(self) -> None:
        """Ends the threads."""
        self.trials.close()
