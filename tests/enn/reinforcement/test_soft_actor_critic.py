"""Soft actor-critic: an update equal to stable-baselines3's, the log-probability of squashed actions."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from enn.networks.network import action_distribution
from enn.reinforcement.replay import demonstration_replay
from enn.reinforcement.sampling import SampledEnvs
from enn.reinforcement.soft_actor_critic import SacLearner
from tests.enn.reinforcement.small_training import SMALL, demonstrated


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
    library = SAC(
        type(model.policy),
        envs,
        learning_rate=settings.learning_rate,
        batch_size=64,
        ent_coef=ent_coef,
        policy_kwargs=dict(model.policy_kwargs),
        device="cpu",
    )
    library.policy.load_state_dict(model.policy.state_dict())
    data = learner.replay.gather(np.arange(60), np.zeros(60, int))

    class Fixed:
        def sample(self, *arguments: Any, **keywords: Any) -> Any:
            return data

    learner.replay.sample = Fixed().sample  # type: ignore[method-assign]
    library.replay_buffer = Fixed()
    from stable_baselines3.common.logger import Logger

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
        assert learner.replay.shown_in(64) == 32
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
