"""Demonstrations of the sampling expert over many anatomies: arrays of one length, actions held, the case kept."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import load_guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.planning.demonstration import demonstrate
from cathsim.planning.plan_trials import ExpertSettings

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


def test_a_demonstration_ends_where_the_expert_has_simulated_enough() -> None:
    environment = NavigateManyEnv(
        ("type_1",), ("bca",), catheter="vertebral", observation="tip", accuracy="fast", max_steps=12
    )
    lengths = [len(demonstrate(environment, 0, (), hold=4, seed=3, steps=steps)["actions"]) for steps in (1, 1e9)]
    assert lengths == [1, 12]
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
