"""Soft actor-critic, whose update equals stable-baselines3's, and what demonstrations add to it and to PPO."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger

from enn.networks.network import action_distribution
from enn.reinforcement.replay import demonstration_replay
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training.settings import DESK_PPO
from enn.reinforcement.training.training import Training
from enn.reinforcement.vector_envs import SampledEnvs
from tests.enn.reinforcement.small_training import SMALL, demonstrated, interrupted, require_same_weights


def _fill(learner: SacLearner, envs: SampledEnvs) -> None:
    """Lets a learner remember sixty random decisions."""
    observations = envs.reset()
    for _ in range(60):
        actions = learner.act(observations, explore=True)
        after, rewards, dones, infos = envs.step(actions)
        learner.observe(observations, rewards, dones, after, infos, explore=True)
        observations = after


@pytest.mark.parametrize("ent_coef", ["auto_0.05", 0.2])
def test_one_update_is_the_librarys(ent_coef: str | float, point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, ent_coef=ent_coef, normalise=False, batch_size=64)
    envs = SampledEnvs([point_env] * 2, seed=0)
    learner = SacLearner(settings, envs, 0)
    _fill(learner, envs)
    model = learner.model
    given = {"learning_rate": settings.learning_rate, "policy_kwargs": dict(model.policy_kwargs)}
    library = SAC(type(model.policy), envs, batch_size=64, ent_coef=ent_coef, device="cpu", **given)
    library.policy.load_state_dict(model.policy.state_dict())
    data = learner.replay.gather(np.arange(60), np.zeros(60, int))

    class Fixed:
        def sample(self, *arguments: Any, **keywords: Any) -> Any:
            return data

    learner.replay.sample = Fixed().sample  # type: ignore[method-assign]
    library.replay_buffer = Fixed()
    library.set_logger(Logger(None, []))
    model.noise = None  # the global generator, as the library
    for one in (library, model):
        torch.manual_seed(5)
        one.train(3, 64)
    theirs = library.policy.state_dict()
    before = dict(SacLearner(settings, envs, 0).policy.state_dict())
    for name, value in model.policy.state_dict().items():
        torch.testing.assert_close(value, theirs[name], atol=2e-5, rtol=2e-4)
        if name.endswith("weight"):
            assert not torch.equal(value, before[name])
    if ent_coef == "auto_0.05":
        torch.testing.assert_close(model.log_ent_coef, library.log_ent_coef, atol=1e-5, rtol=1e-4)


def test_demonstrated_actions_are_cloned_where_the_critics_prefer_them(point_env: Any) -> None:
    envs = SampledEnvs([point_env], seed=0)
    shown = demonstration_replay(demonstrated(point_env), envs.observation_space, point_env.action_space)
    settings = dataclasses.replace(SMALL, batch_size=64, demonstrations_in_replay=0.5, cloning_weight=50.0)
    far = []
    for weight in (0.0, settings.cloning_weight):
        learner = SacLearner(dataclasses.replace(settings, cloning_weight=weight), envs, 0, shown)
        _fill(learner, envs)
        model = learner.model
        data = learner.replay.sample(64)
        assert learner.replay.demonstrations_in(64) == 32
        given = shown.gather(np.arange(shown.added), np.zeros(shown.added, int))
        assert {tuple(one) for one in data.actions[-32:].tolist()} <= {tuple(one) for one in given.actions.tolist()}
        # nothing is cloned where the policy's own actions are worth more, all of it where they are worth less
        own = torch.full((64, 1), 1e6)
        mean, _ = action_distribution(model.policy, data.observations)
        assert model._cloning_loss(data, mean, own, 32).item() == 0.0
        expected = 1e6 * (mean[-32:].tanh() - data.actions[-32:]).square().sum(1).mean()
        torch.testing.assert_close(model._cloning_loss(data, mean, -own, 32), expected)
        model.train(200, 64)
        mean, _ = action_distribution(model.policy, given.observations)
        far.append((mean.tanh() - given.actions).square().mean().item())
    assert far[1] < 0.7 * far[0]


SMALL_PPO = dataclasses.replace(
    DESK_PPO, action_repeat=1, decisions=104, n_envs=4, hidden=(32, 32), learning_starts=100, batch_size=32,
    learning_rate=7e-4, log_std_final=None, evaluate_every=0, curve_every=50,
)  # fmt: skip


def test_actions_of_demonstrations_are_cloned_before_the_first_roll_out(point_env: Any) -> None:
    trajectories = demonstrated(point_env)
    places = np.concatenate([one.observations["place"][:-1] for one in trajectories])
    wanted = np.concatenate([one.actions for one in trajectories])
    errors = []
    for settings, shown in (
        (SMALL_PPO, trajectories),
        (SMALL_PPO, ()),
        (dataclasses.replace(SMALL_PPO, cloning_weight=0.0), trajectories),
    ):
        policy = Training(settings, point_env, None, 0, shown).run().policy
        errors.append(float(np.abs(policy.act_batch({"place": places}) - wanted).mean()))
        assert torch.equal(policy.module.log_std, torch.full((2,), settings.log_std_init))
    assert errors[0] < 0.1
    assert min(errors[1:]) > 0.5


def test_a_training_with_demonstrations_and_a_falling_deviation_is_resumed_as_if_it_had_not_been_interrupted(
    point_env: Any, tmp_path: Path
) -> None:
    changed = {"decisions": 240, "n_steps": 8, "start_state_buffer_share": 0.0, "log_std_final": -2.5}
    settings = dataclasses.replace(SMALL_PPO, **changed)
    shown = demonstrated(point_env)
    straight = Training(settings, point_env, None, 1, shown).run().policy
    interrupted(Training(settings, point_env, tmp_path, 1, shown), 150)
    require_same_weights(straight, Training(settings, point_env, tmp_path, 1, shown).run().policy)


def test_an_environment_may_observe_more_than_the_networks_read(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL_PPO, keys=("place",), start_state_buffer_share=0.0, cloning_weight=0.0)
    policy = Training(settings, lambda: point_env(("place", "range"), max_steps=10), None, 1).run().policy
    assert policy.keys == ("place",)


def test_the_deviation_of_actions_falls_evenly_to_the_end_of_the_budget(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL_PPO, decisions=700, log_std_final=-2.5, start_state_buffer_share=0.0)
    # after 100 random decisions roll-outs of 128: the last that was full ended at 612 of the 700
    policy = Training(settings, point_env, None, 1).run().policy
    assert torch.allclose(policy.module.log_std, torch.full((2,), -1.0 - 1.5 * 612 / 700))


def test_a_policy_to_start_from_gives_the_deviation_only_where_it_is_learnt(point_env: Any) -> None:
    weights = Training(SMALL_PPO, point_env, None, 0).run().policy
    weights.module.log_std.data.fill_(0.3)
    for final, expected in ((None, 0.3), (-2.5, -1.0)):
        settings = dataclasses.replace(SMALL_PPO, log_std_final=final, decisions=4, n_envs=4)
        started = Training(settings, point_env, None, 0, initial=weights).run().policy
        assert torch.allclose(started.module.log_std, torch.full((2,), expected)), final
