"""The sampling expert: it solves the task by itself, and repeats itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.planning.plan_trials import ExpertSettings, PlanTrials
from cathsim.planning.sampling import SamplingExpert

MakeEnv = Callable[..., NavigateEnv]
SMALL = ExpertSettings(horizon=6, execute=3, samples=8, elites=3, rounds=2)


def plan(env: NavigateEnv, steps: int, *, seed: int = 0, threads: int = 1) -> np.ndarray:
    """Actions of a small expert from deep in the aorta, shape (steps, 2)."""
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    expert = SamplingExpert(env, seed=seed, settings=SMALL, threads=threads)
    taken = []
    for _ in range(steps):
        taken.append(expert.action())
        env.step(taken[-1])
    expert.close()
    return np.array(taken)


def test_expert_reaches_the_lcca(make_env: MakeEnv) -> None:
    env = make_env(target="lcca", accuracy="accurate")
    expert = SamplingExpert(env, seed=0)
    env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        action = expert.action()
        assert (action.shape, action.dtype) == ((2,), np.float32)
        _, reward, terminated, truncated, info = env.step(action)
    expert.close()
    assert terminated
    assert info["distance"] <= 0.008
    assert reward == 10.0
    assert env.steps <= 300
    assert expert.rollouts > 0


def test_same_seed_same_plan_whatever_the_threads(make_env: MakeEnv) -> None:
    env = make_env(target="lcca")
    one = plan(env, 12)
    assert np.array_equal(plan(env, 12), one)
    assert np.array_equal(plan(env, 12, threads=3), one)
    assert not np.array_equal(plan(env, 12, seed=1), one)


def test_restart_forgets_the_plan(make_env: MakeEnv) -> None:
    env = make_env(target="lcca")
    expert = SamplingExpert(env, seed=2, settings=SMALL, threads=1)
    runs = []
    for _ in range(2):
        env.reset(seed=0)
        env.simulation.reset(insertion=0.12)
        expert.restart(seed=2)
        runs.append([expert.action() for _ in range(3)])
    assert np.array_equal(runs[0], runs[1])


def test_planning_leaves_the_environment_alone(make_env: MakeEnv) -> None:
    env = make_env(target="bca")
    env.reset(seed=0)
    before = env.simulation.state()
    SamplingExpert(env, seed=0, settings=SMALL, threads=1).action()
    assert np.array_equal(env.simulation.state(), before)


def test_bad_settings_are_refused(make_env: MakeEnv) -> None:
    with pytest.raises(ValueError, match=r"elites must lie in 1 to samples \(24\), got 30"):
        ExpertSettings(elites=30)
    with pytest.raises(ValueError, match=r"hold and execute must lie in 1 to the horizon \(2\)"):
        ExpertSettings(horizon=2)
    with pytest.raises(ValueError, match="the sampling expert steers the actions of the feeders"):
        SamplingExpert(make_env(actions="tip_motors"))


def test_a_tip_that_gets_no_nearer_is_drawn_back(make_env: MakeEnv) -> None:
    env = make_env(target="lcca")
    expert = SamplingExpert(env, seed=0, settings=dataclasses.replace(SMALL, patience=2), threads=1)
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    here = env.task.remaining(env.phantom, env.simulation.tip_in_vessel)
    expert._nearest = here - 0.1  # as if it had been nearer, where no manoeuvre gets
    for _ in range(2):
        assert expert.escapes == 0
        action = expert.action()
        expert._left = 0
    assert expert.escapes == 1
    assert action[0] < 0
    expert.restart()
    assert not expert._stalled(here)


def test_a_retreat_is_drawn_again_until_one_is_gentle(make_env: MakeEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_env(target="lcca")
    env.reset(seed=0)
    expert = SamplingExpert(env, settings=dataclasses.replace(SMALL, most_force=2.0), threads=1)
    forces = iter([5.0, 3.0, 1.0])
    drawn: list[np.ndarray] = []

    def told(self: PlanTrials, state: np.ndarray, plan: np.ndarray) -> float:
        drawn.append(plan)
        return next(forces)

    monkeypatch.setattr(PlanTrials, "largest_force", told)
    chosen = expert._gentle_retreat(env.simulation.state(), 0.0)
    assert len(drawn) == 3
    assert chosen is drawn[2]
