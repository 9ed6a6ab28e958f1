"""What a training may see: demonstrations, images, a frozen encoder, a critic of its own, the simulator; never NaN."""

import dataclasses
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.policy import Policy
from enn.reinforcement.replay import demonstration_replay
from enn.reinforcement.sampling import SampledEnvs
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training import (
    Progress,
    Training,
)
from enn.reinforcement.training.training import TrainingRun
from tests.enn.reinforcement.small_training import SMALL, demonstrated


def test_demonstrations_enter_bank_and_replay(point_env: Any) -> None:
    trajectories = demonstrated(point_env)
    settings = dataclasses.replace(
        SMALL, decisions=240, demonstrations_in_replay=0.25, evaluate_every=0, reset_bank_share=1.0
    )

    run = TrainingRun(Training(settings, point_env, None, 0, trajectories), None)
    assert isinstance(run.learner, SacLearner)
    assert run.learner.replay.demonstrations.added == sum(map(len, trajectories))
    assert isinstance(run.sampled, SampledEnvs)
    assert len(run.sampled.reset_bank) >= 3
    drawn = run.learner.replay.demonstrations.gather(
        np.arange(len(trajectories[0])), np.zeros(len(trajectories[0]), int)
    )
    np.testing.assert_allclose(drawn.actions, trajectories[0].actions, atol=1e-6)
    np.testing.assert_allclose(drawn.next_observations["place"], trajectories[0].observations["place"][1:])
    assert drawn.dones[-1] == 1.0
    starts = run.envs.reset()["place"]
    known = np.concatenate([t.observations["place"] for t in trajectories])
    assert all(np.abs(known - start).max(axis=1).min() < 1e-6 for start in starts)
    result = run.train()
    assert result.evaluation is None

    held = demonstration_replay(
        trajectories[:1], run.envs.observation_space, point_env.action_space, action_repeat=len(trajectories[0])
    )
    assert held.added == 1
    whole = held.gather(np.zeros(1, int), np.zeros(1, int))
    np.testing.assert_allclose(whole.actions[0], trajectories[0].actions.mean(axis=0), atol=1e-6)
    assert float(whole.rewards) == pytest.approx(trajectories[0].rewards.sum(), rel=1e-5)
    np.testing.assert_allclose(whole.next_observations["place"][0], trajectories[0].observations["place"][-1])
    with pytest.raises(ValueError, match="no demonstrations to put"):
        demonstration_replay([], run.envs.observation_space, point_env.action_space)


def test_the_real_simulator_trains_a_little(tmp_path: Path) -> None:
    pytest.importorskip("cathsim")

    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make(
            "cathsim:cathsim/Navigate-v0",
            observation=("shape", "feeder"),
            reward="geodesic",
            success_radius=0.008,
            max_steps=20,
            start_jitter=0.001,
            start_rotation=np.pi,
            disable_env_checker=True,
        )

    settings = dataclasses.replace(
        SMALL,
        decisions=120,
        n_envs=2,
        learning_starts=60,
        evaluate_every=120,
        evaluation_episodes=2,
        gradient_steps=0.2,
    )
    result = Training(settings, make, None, seed=0).run()
    assert result.evaluation["steps"] == 20

    def stop(moment: Progress) -> None:
        if moment.decisions >= 80:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("enn.reinforcement.training.training.TICK", 0.0)
        with pytest.raises(KeyboardInterrupt):
            Training(settings, make, tmp_path, seed=0).run(stop)
    resumed = Training(settings, make, tmp_path, seed=0).run()
    assert resumed.evaluation == result.evaluation
    theirs = resumed.policy.module.state_dict()
    assert all(torch.equal(value, theirs[name]) for name, value in result.policy.module.state_dict().items())
    assert result.evaluation["path_mm"] > 0
    assert Policy.load(tmp_path / "policy.pt").keys == ("feeder", "shape")


def test_with_a_frozen_encoder_it_trains_resumes_and_loads(point_env: Any, tmp_path: Path) -> None:
    def make() -> Any:
        return point_env(("place", "mask"), max_steps=15)

    torch.manual_seed(0)
    encoder = Encoder(EncoderSettings(keys=("mask",), shapes=((1, 36, 36),), channels=(4,), hidden=16, features=8))
    before = {name: value.clone() for name, value in encoder.state_dict().items()}
    settings = dataclasses.replace(
        SMALL, passthrough=("place",), decisions=240, learning_starts=80, evaluate_every=120, evaluation_episodes=3
    )
    straight = Training(settings, make, None, seed=0, encoder=encoder).run()

    class Interruption(Exception):
        pass

    def stop(moment: Progress) -> None:
        if moment.decisions >= 120:
            raise Interruption

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("enn.reinforcement.training.training.TICK", 0.0)
        with pytest.raises(Interruption):
            Training(settings, make, tmp_path, seed=0, encoder=encoder).run(stop)
    resumed = Training(settings, make, tmp_path, seed=0, encoder=encoder).run()
    batch = {"mask": np.zeros((4, 1, 36, 36), np.uint8), "place": np.linspace(-1, 1, 8, dtype=np.float32).reshape(4, 2)}
    batch["mask"][np.arange(4), 0, np.arange(4), 5] = 255
    loaded = Policy.load(tmp_path / "policy.pt")
    assert loaded.keys == ("mask", "place")
    assert loaded.features(batch).shape == (4, 10)
    np.testing.assert_array_equal(straight.policy.act_batch(batch), resumed.policy.act_batch(batch))
    np.testing.assert_array_equal(loaded.act_batch(batch), resumed.policy.act_batch(batch))
    assert all(torch.equal(value, before[name]) for name, value in encoder.state_dict().items())
    with pytest.raises(ValueError, match="'mask' of shape \\(1, 36, 36\\), got \\(1, 40, 40\\): another image size"):
        loaded.act({"mask": np.zeros((1, 40, 40), np.uint8), "place": np.zeros(2, np.float32)})


def test_an_asymmetric_critic_needs_nothing_to_act(point_env: Any, tmp_path: Path) -> None:
    settings = dataclasses.replace(
        SMALL, keys=("place",), critic_keys=("place", "range"), decisions=240, evaluate_every=240
    )
    Training(settings, lambda: point_env(("place", "range", "mask")), tmp_path, seed=0).run()
    loaded = Policy.load(tmp_path / "policy.pt")
    assert loaded.keys == ("place",)
    assert loaded.act({"place": np.zeros(2, np.float32)}).shape == (2,)
