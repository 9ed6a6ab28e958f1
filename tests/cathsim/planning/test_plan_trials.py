"""Trials of plans: what is claimed is checked, what presses is refused, threads change nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.planning.manoeuvres import Manoeuvre
from cathsim.planning.plan_trials import ExpertSettings, PlanTrials
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation

MakeEnv = Callable[..., NavigateEnv]


def test_claims_are_checked_in_the_environments_own_steps(make_env: MakeEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_env(target="lcca", accuracy="accurate")
    trials = PlanTrials(env, ExpertSettings(confirm=2), ACCURACY["fast"], 1)
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    own = trials.confirming
    assert own is not None
    assert own.numerics == env.simulation.numerics
    real = PlanTrials._cost

    def claiming(self: PlanTrials, copy: Simulation, state: np.ndarray, plan: np.ndarray) -> float:
        return real(self, copy, state, plan) if copy is own else -0.9

    monkeypatch.setattr(PlanTrials, "_cost", claiming)
    plans = np.zeros((4, 3, 2))
    costs = trials.costs(env.simulation.state(), plans)
    here = env.task.remaining(env.phantom, env.simulation.tip_in_vessel)
    assert costs[:2] == pytest.approx(here, abs=0.002)
    assert (costs[2:] == 1.0).all(), "claims that were not checked are not believed"


def test_forces_beyond_the_most_cost_more_than_any_distance_gains(make_env: MakeEnv) -> None:
    env = make_env(target="lcca")
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    state, plan = env.simulation.state(), np.tile([1.0, 0.0], (8, 1))
    free = PlanTrials(env, ExpertSettings(), ACCURACY["fast"], 1)
    largest = free.largest_force(state, plan)
    assert largest > 0.0
    limit = 0.5 * largest
    bound = PlanTrials(env, ExpertSettings(most_force=limit), ACCURACY["fast"], 1)
    costs = [float(trials.costs(state, plan[None])[0]) for trials in (free, bound)]
    assert costs[1] - costs[0] == pytest.approx(largest - limit)
    through = Manoeuvre(np.zeros(3), plan, 0)
    endings = [trials.endings(state, [through])[0] for trials in (free, bound)]
    assert endings[0][1] > endings[1][1] or endings[0][0] < endings[1][0], "the manoeuvre ends where the force is"


def test_threads_change_no_cost(make_env: MakeEnv) -> None:
    env = make_env(target="lcca")
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    state = env.simulation.state()
    plans = np.random.default_rng(0).uniform(-1, 1, (5, 4, 2))
    costs = []
    for threads in (1, 3):
        trials = PlanTrials(env, ExpertSettings(), ACCURACY["fast"], threads)
        costs.append(trials.costs(state, plans))
        assert (trials.rollouts, trials.steps) == (5, 20)
        trials.close()
    assert np.array_equal(*costs)
    assert len(set(costs[0].tolist())) == 5


def test_an_ending_is_confirmed_only_where_that_is_asked_for(make_env: MakeEnv) -> None:
    env = make_env(target="lcca", accuracy="accurate")
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    state, tried = env.simulation.state(), Manoeuvre(np.zeros(3), np.tile([1.0, 0.0], (8, 1)), 0)
    found = PlanTrials(env, ExpertSettings(), ACCURACY["fast"], 1)
    checked = PlanTrials(env, ExpertSettings(confirm=1), ACCURACY["fast"], 1)
    assert found.confirmed(state, tried, (0.5, 3)) == (0.5, 3)
    cost, steps = checked.confirmed(state, tried, (0.5, 3))
    assert (cost, steps) != (0.5, 3)
    assert (found.rollouts, checked.rollouts) == (0, 1)
    assert (found.steps, checked.steps) == (0, 8)
