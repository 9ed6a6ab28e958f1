"""Proximal policy optimisation: what demonstrations add to it."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.reinforcement.training import DESK_PPO, Training
from tests.enn.reinforcement.small_training import demonstrated

SMALL = dataclasses.replace(
    DESK_PPO, action_repeat=1, decisions=104, n_envs=4, hidden=(32, 32), learning_starts=100, batch_size=32,
    learning_rate=7e-4, log_std_final=None, evaluate_every=0, curve_every=50,
)  # fmt: skip


def test_actions_of_demonstrations_are_cloned_before_the_first_roll_out(point_env: Any) -> None:
    trajectories = demonstrated(point_env)
    places = np.concatenate([one.observations["place"][:-1] for one in trajectories])
    wanted = np.concatenate([one.actions for one in trajectories])
    errors = []
    for settings, shown in (
        (SMALL, trajectories),
        (SMALL, ()),
        (dataclasses.replace(SMALL, cloning_weight=0.0), trajectories),
    ):
        policy = Training(settings, point_env, None, 0, shown).run().policy
        errors.append(float(np.abs(policy.act_batch({"place": places}) - wanted).mean()))
        assert torch.equal(policy.module.log_std, torch.full((2,), settings.log_std_init))
    assert errors[0] < 0.1
    assert min(errors[1:]) > 0.5


def test_a_training_with_demonstrations_is_resumed_as_if_it_had_not_been_interrupted(
    point_env: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)
    settings, shown = dataclasses.replace(SMALL, decisions=500, reset_bank_share=0.0), demonstrated(point_env)
    straight = Training(settings, point_env, None, 1, shown).run().policy

    def stop(moment: Any) -> None:
        if moment.decisions >= 300:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        Training(settings, point_env, tmp_path, 1, shown).run(stop)
    resumed = Training(settings, point_env, tmp_path, 1, shown).run().policy
    for name, value in straight.module.state_dict().items():
        assert torch.equal(value, resumed.module.state_dict()[name]), name


def test_an_environment_may_observe_more_than_the_networks_read(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, keys=("place",), decisions=300, reset_bank_share=0.0, cloning_weight=0.0)
    policy = Training(settings, lambda: point_env(("place", "range"), max_steps=10), None, 1).run().policy
    assert policy.keys == ("place",)


def test_the_deviation_of_actions_falls_evenly_to_the_end_of_the_budget(
    point_env: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)
    settings = dataclasses.replace(
        SMALL, decisions=700, learning_starts=100, log_std_final=-2.5, reset_bank_share=0.0, cloning_weight=0.0
    )
    # after 100 random decisions roll-outs of 128: the last that was full ended at 612 of the 700
    policy = Training(settings, point_env, None, 1).run().policy
    assert torch.allclose(policy.module.log_std, torch.full((2,), -1.0 - 1.5 * 612 / 700))

    def stop(moment: Any) -> None:
        if moment.decisions >= 300:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        Training(settings, point_env, tmp_path, 1).run(stop)
    resumed = Training(settings, point_env, tmp_path, 1).run().policy
    for name, value in policy.module.state_dict().items():
        assert torch.equal(value, resumed.module.state_dict()[name]), name


def test_a_deviation_that_is_settled_leaves_no_entropy_to_weigh() -> None:
    with pytest.raises(ValueError, match=r"log_std_final settles the entropy.*got 0\.01"):
        dataclasses.replace(SMALL, log_std_final=-2.5, ent_coef=0.01)


def test_a_policy_to_start_from_gives_the_deviation_only_where_it_is_learnt(point_env: Any) -> None:
    weights = Training(SMALL, point_env, None, 0).run().policy
    weights.module.log_std.data.fill_(0.3)
    for final, expected in ((None, 0.3), (-2.5, -1.0)):
        settings = dataclasses.replace(SMALL, log_std_final=final, decisions=4, n_envs=4)
        started = Training(settings, point_env, None, 0, initial=weights).run().policy
        assert torch.allclose(started.module.log_std, torch.full((2,), expected)), final
