"""Plans: manoeuvres, trials of them, scripts, the expert that chooses them, its demonstrations."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from cathsim import NavigateEnv, load_phantom
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.planning.demonstration import demonstrate
from cathsim.planning.manoeuvres import Ending, Manoeuvre, parameter_limits, retreat, search_manoeuvres
from cathsim.planning.plan_trials import ExpertSettings, PlanTrials
from cathsim.planning.sampling import BEYOND, EMERGED, SamplingExpert, wire_advances
from cathsim.planning.scripted_motions import MOTIONS, ROOT, Script, ScriptedOperator, arch_branches, placement_paths
from cathsim.presets import ACCURACY, PACES
from cathsim.simulation import Simulation
from tests.cathsim.makers import MakeEnv

SMALL = ExpertSettings(horizon=6, execute=3, samples=8, elites=3, rounds=2)


@pytest.fixture
def env(make_env: MakeEnv) -> NavigateEnv:
    """With the wire deep in the aorta."""
    env = make_env(target="lcca", accuracy="accurate")
    env.reset(seed=0)
    env.simulation.reset(insertion=0.12)
    return env


def test_claims_are_checked_in_the_environments_own_steps(env: NavigateEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    trials = PlanTrials(env, ExpertSettings(confirm=2), ACCURACY["fast"], 1)
    own = trials.confirming
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


def test_an_ending_is_confirmed_only_where_that_is_asked_for(env: NavigateEnv) -> None:
    state, tried = env.simulation.state(), Manoeuvre(np.zeros(3), np.tile([1.0, 0.0], (8, 1)), 0)
    found = PlanTrials(env, ExpertSettings(), ACCURACY["fast"], 1)
    checked = PlanTrials(env, ExpertSettings(confirm=1), ACCURACY["fast"], 1)
    assert found.confirmed(state, tried, (0.5, 3)) == (0.5, 3)
    cost, steps = checked.confirmed(state, tried, (0.5, 3))
    assert (cost, steps) != (0.5, 3)
    assert (found.rollouts, checked.rollouts) == (0, 1)
    assert (found.steps, checked.steps) == (0, 8)


PACE = PACES["usual"]


def moved(plan: np.ndarray) -> np.ndarray:
    """What a plan moves in all: m and rad of each device."""
    return plan.sum(axis=0) * np.resize([PACE.translation, PACE.rotation], plan.shape[1])


def test_search_finds_a_better_manoeuvre_than_it_draws_at_first() -> None:
    low, high = parameter_limits(4)
    aim = low + 0.3 * (high - low)
    first: list[float] = []

    def evaluate(tried: Sequence[Manoeuvre]) -> list[Ending]:
        costs = [float(np.abs((one.parameters - aim) / (high - low)).sum()) for one in tried]
        first.append(min(costs))
        return [(cost, 5) for cost in costs]

    found = search_manoeuvres(evaluate, np.random.default_rng(0), 4, PACE)
    costs = [cost for (cost, _), _ in found]
    assert costs == sorted(costs)
    assert costs[0] < first[0]


@pytest.mark.parametrize("lead", [-0.03, 0.0, 0.05])
def test_a_retreat_draws_the_foremost_tip_back(lead: float) -> None:
    wire, _, catheter, _ = moved(retreat(np.random.default_rng(1), 4, PACE, lead=lead))
    foremost = max(lead + wire, catheter)  # before the catheter's tip at the start
    assert -0.10 <= foremost - max(lead, 0.0) <= -0.03
    assert 0.0 <= lead + wire - catheter <= 0.05
    assert -0.10 <= moved(retreat(np.random.default_rng(1), 2, PACE))[0] <= -0.03


def test_paths_lead_from_the_entry_to_every_end_of_a_branch() -> None:
    phantom = load_phantom("type_1")
    assert {"bca", "lcca"} <= set(arch_branches(phantom))
    entry = phantom.entry("descending").position
    for target in (*arch_branches(phantom), ROOT):
        for path in placement_paths(phantom, target):
            assert np.linalg.norm(path[0] - entry) < 0.01
            assert (phantom.grid.sample(path) > 0).mean() > 0.95  # inside the lumen
    assert placement_paths(phantom, "bca") is placement_paths(phantom, "bca")


def test_a_script_repeats_itself_and_a_tip_that_nobody_sees_ends_in_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script("type_1", "bca", "angled", shapes=2, steps=1, seed=3)
    operator = ScriptedOperator(load_phantom("type_1"), "angled")
    motion, shapes = operator.film(script, lambda tip: True)
    again, same = operator.film(script, lambda tip: True)
    assert motion == again
    assert motion in MOTIONS
    assert all(np.array_equal(one, other) for one, other in zip(shapes, same, strict=True))
    monkeypatch.setattr("cathsim.planning.scripted_motions._RESTARTS", 1)
    with pytest.raises(RuntimeError, match="came to an end"):
        operator.film(script, lambda tip: False)


def test_plans_that_bring_the_wire_out_are_as_long_as_it_takes() -> None:
    plans = wire_advances(-0.08, 0.002)
    assert len(plans) > 3
    for plan in plans:
        assert plan.shape[1] == 4
        assert 0.002 * plan[:, 0].sum() == pytest.approx(0.08 + BEYOND, abs=0.002)
    assert len(wire_advances(EMERGED, 0.002)) == 0


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
    before = env.simulation.state()
    SamplingExpert(env, seed=0, settings=SMALL, threads=1).action()
    assert np.array_equal(env.simulation.state(), before), "planning leaves the environment alone"


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


@pytest.mark.parametrize(("catheter", "groups"), [(None, 4), ("vertebral", 2)])
def test_a_demonstration_is_a_trajectory_of_held_actions_in_its_case(catheter: str | None, groups: int) -> None:
    aorta = load_phantom("type_1").tree.root
    entry = tuple(aorta.point_at(0.5 * aorta.length).tolist())  # shortly before the branches: steered at once
    settings = {"catheter": catheter, "entry": entry, "observation": KEYS, "accuracy": "fast"}
    environment = NavigateManyEnv(("type_1",), ("bca", "lcca"), max_steps=4 * groups, **settings)
    made = demonstrate(environment, 1, KEYS, hold=4, seed=3)
    assert {*KEYS, "tips", "states", "actions", "rewards", "forces", "terminated"} == set(made)
    assert [len(made[name]) for name in (*KEYS, "tips", "states")] == [4 * groups + 1] * 4
    assert [len(made[name]) for name in ("actions", "rewards", "forces")] == [4 * groups] * 3
    assert (made["states"][:, -1] == 1).all()  # the case comes along
    held = made["actions"].reshape(groups, 4, 2 if catheter is None else 4)
    assert (held == held[:, :1]).all()
    assert catheter is not None or len(np.unique(held[:, 0], axis=0)) > 1
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
