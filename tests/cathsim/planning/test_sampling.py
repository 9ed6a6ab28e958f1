"""The expert: plans, retreats, demonstrations."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv, load_guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.planning.demonstration import demonstrate
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


KEYS = ("roadmap", "history")


def test_a_demonstration_is_a_trajectory_of_held_actions_in_its_case() -> None:
    wire = load_guidewire("default").scaled(0.312)
    environment = NavigateManyEnv((0,), ("bca", "lcca"), (wire,), observation=KEYS, accuracy="fast", max_steps=80)
    made = demonstrate(environment, 1, KEYS, hold=4, seed=3)
    assert {*KEYS, "tips", "states", "actions", "rewards", "forces", "terminated"} == set(made)
    assert [len(made[name]) for name in (*KEYS, "tips", "states")] == [81] * 4
    assert [len(made[name]) for name in ("actions", "rewards", "forces")] == [80] * 3
    assert (made["states"][:, -1] == 1).all()  # the case comes along
    held = made["actions"].reshape(20, 4, 2)
    assert (held == held[:, :1]).all()
    assert len(np.unique(held[:, 0], axis=0)) > 1
    environment.close()


def test_a_demonstration_with_two_devices_has_four_actions_that_are_held() -> None:
    environment = NavigateManyEnv(
        ("type_1",), ("bca",), catheter="vertebral", observation="devices", accuracy="fast", max_steps=8
    )
    environment.reset(seed=0)
    made = demonstrate(environment, 0, (), hold=4, seed=3)
    assert made["actions"].shape == (8, 4)
    held = made["actions"].reshape(2, 4, 4)
    assert (held == held[:, :1]).all()
    environment.close()


@pytest.mark.parametrize(("catheter", "usual"), [(None, 1000.0), ("vertebral", 2.0)])
def test_a_gentle_one_is_limited_in_force(catheter: str | None, usual: float, monkeypatch: pytest.MonkeyPatch) -> None:
    class Searches(Exception):
        pass

    def search(*_: object, settings: ExpertSettings, **__: object) -> None:
        raise Searches(settings)

    monkeypatch.setattr("cathsim.planning.demonstration.SamplingExpert", search)
    environment = NavigateManyEnv(("type_1",), ("bca",), catheter=catheter, observation="tip", max_steps=8)
    for gentle, most in ((False, usual), (True, 0.4)):
        with pytest.raises(Searches) as raised:
            demonstrate(environment, 0, (), hold=3, seed=0, gentle=gentle)
        (settings,) = raised.value.args
        assert (settings.most_force, settings.hold) == (most, 3)
    environment.close()
