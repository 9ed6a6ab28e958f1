"""Reinforcement learning: it learns, keeps the best, reports its curve, and updates as stable-baselines3 does."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from enn.networks.network import action_distribution
from enn.policy import Policy
from enn.reinforcement.evaluation import EpisodeOutcome, EvaluationResult, run_episodes
from enn.reinforcement.sampling import SampledEnvs
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training import (
    DESK_PPO,
    DESK_SAC,
    THESIS_PPO,
    THESIS_SAC,
    Progress,
    Training,
    TrainingSettings,
)
from enn.reinforcement.training_result import COLUMNS
from enn.reinforcement.training_run import TrainingRun
from tests.enn.reinforcement.small_training import SMALL


def test_sac_learns_and_its_curve_and_files_say_so(point_env: Any, tmp_path: Path) -> None:
    seen: list[Progress] = []
    settings = dataclasses.replace(SMALL, gradient_steps=1.0)
    result = Training(settings, point_env, tmp_path, seed=3, metadata={"target": "centre"}).run(seen.append)
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12
    lines = (tmp_path / "training.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) == 1 + len(result.curve) == 10
    assert [row["decisions"] for row in result.curve] == [104, 200, 304, 400, 504, 600, 704, 800, 904]
    assert result.curve[-1]["reward"] > result.curve[0]["reward"]
    assert result.curve[2]["evaluation_success"] is not None
    assert result.curve[3]["evaluation_success"] is None
    record = json.loads((tmp_path / "training.json").read_text())
    assert record["settings"]["hidden"] == [32, 32]
    assert record["metadata"] == {"seed": 3, "target": "centre", "decisions": 904}
    assert seen[0].decisions == 0
    assert seen[-1].total == 900
    assert result.timings["updates"] == pytest.approx(704, abs=8)
    assert not (tmp_path / "tensorboard").exists()
    loaded = Policy.load(tmp_path / "policy.pt")
    played = run_episodes(loaded, [point_env()], [7, 8, 9], deterministic=True)
    assert played.success == 1.0


def test_ppo_learns(point_env: Any) -> None:
    settings = dataclasses.replace(
        DESK_PPO,
        action_repeat=1,
        decisions=6000,
        hidden=(32, 32),
        learning_starts=200,
        n_steps=64,
        learning_rate=3e-3,
        evaluate_every=3000,
        evaluation_episodes=5,
    )
    result = Training(settings, point_env, None, seed=0).run()
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0
    assert result.evaluation["steps"] < 12


def test_the_same_seed_gives_the_same_training(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, decisions=320, evaluate_every=160)
    weights = []
    for seed in (2, 2, 3):
        policy = Training(settings, point_env, None, seed=seed).run().policy
        weights.append(torch.cat([value.flatten() for value in policy.module.actor.parameters()]))
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


@pytest.mark.parametrize("ent_coef", ["auto_0.05", 0.2])
def test_one_update_is_the_librarys(ent_coef: str | float, point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, ent_coef=ent_coef, normalise=False, batch_size=64)
    envs = SampledEnvs([point_env] * 2, seed=0)
    learner = SacLearner(settings, envs, 0)
    observations = envs.reset()
    for _ in range(60):
        actions = learner.act(observations, explore=True)
        after, rewards, dones, infos = envs.step(actions)
        learner.observe(observations, rewards, dones, after, infos, explore=True)
        observations = after
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
        assert library.log_ent_coef is not None
        assert model.log_ent_coef is not None
        torch.testing.assert_close(model.log_ent_coef, library.log_ent_coef, atol=1e-5, rtol=1e-4)


def test_log_probability_is_that_of_the_squashed_gaussian(point_env: Any) -> None:
    learner = SacLearner(SMALL, SampledEnvs([point_env], seed=0), 0)
    observations = {"place": torch.randn(50, 2, generator=torch.Generator().manual_seed(0))}
    actions, log_prob = learner.model.sample_actions(observations)
    mean, log_std = action_distribution(learner.policy, observations)
    raw = torch.atanh(actions.double().clamp(-1 + 1e-9, 1 - 1e-9))
    expected = torch.distributions.Normal(mean.double(), log_std.double().exp()).log_prob(raw)
    expected -= torch.log(1 - actions.double() ** 2)
    torch.testing.assert_close(log_prob[:, 0].double(), expected.sum(1), atol=1e-3, rtol=1e-3)


def test_the_best_policy_is_kept_not_the_last(point_env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    successes, weights = iter([1, 2, 2, 1]), []

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, tick: Any) -> EvaluationResult:
        if not deterministic:
            return EvaluationResult((EpisodeOutcome(True, 10, 0.0, 0.0, 0.0, 0.0),))
        assert len(seeds) == 3
        weights.append(torch.cat([value.flatten().clone() for value in policy.module.actor.parameters()]))
        success = next(successes)
        path_mm = 30.0 if len(weights) == 2 else 25.0
        return EvaluationResult(
            tuple(EpisodeOutcome(number < success, 20, 0.0, path_mm, 0.0, 0.0) for number in range(3))
        )

    monkeypatch.setattr("enn.reinforcement.best_policy.run_episodes", played)
    settings = dataclasses.replace(SMALL, decisions=800, evaluate_every=200, evaluation_episodes=3)
    result = Training(settings, point_env, None, seed=1).run()
    kept = torch.cat([value.flatten() for value in result.policy.module.actor.parameters()])
    # as successful as the second, but shorter
    assert [torch.equal(kept, one) for one in weights] == [False, False, True, False]
    assert result.evaluation is not None
    assert result.evaluation["decisions"] == 600
    assert result.evaluation["path_mm"] == 25


def test_evaluation_is_the_same_for_the_same_seeds(point_env: Any) -> None:
    result = Training(dataclasses.replace(SMALL, decisions=800, evaluate_every=800), point_env, None, seed=1).run()
    assert result.evaluation is not None
    for count in (1, 3):  # environments side by side
        again = run_episodes(
            result.policy, [point_env() for _ in range(count)], range(501_000, 501_005), deterministic=True
        )
        assert (again.success, again.steps) == (result.evaluation["success"], result.evaluation["steps"])
        assert again.path_mm == pytest.approx(result.evaluation["path_mm"])
    drawn = run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn == run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn != run_episodes(result.policy, [point_env()], range(9), deterministic=True)


def test_stops_early_once_perfect_and_no_shorter(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, decisions=100_000, evaluate_every=200, stop_after=2)
    result = Training(settings, point_env, None, seed=1).run()
    assert result.timings["decisions"] < 4000
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0


def test_action_repeat_counts_steps_and_is_played_in_evaluation(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, action_repeat=2, decisions=400, evaluate_every=400)
    result = Training(settings, point_env, None, seed=0).run()
    assert result.policy.action_repeat == 2
    assert 1.5 * 400 < result.timings["env_steps"] <= 800


def test_event_files_on_request(point_env: Any, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    settings = dataclasses.replace(SMALL, decisions=240, evaluate_every=0, tensorboard=True)
    Training(settings, point_env, tmp_path).run()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("curve/reward")] == [104, 200, 240]
    assert "train/critic_loss" in events.Tags()["scalars"]


def test_the_thesis_presets_are_its_tables() -> None:
    table = {
        "learning_rate": 3e-4,
        "buffer_size": 1_000_000,
        "batch_size": 256,
        "tau": 0.005,
        "gamma": 0.99,
        "gradient_steps": 1,
        "ent_coef": "auto_1.0",  # its 1, where the learning starts
        "target_entropy": None,  # its -2, for two actions
    }
    assert {name: getattr(THESIS_SAC, name) for name in table} == table
    assert THESIS_SAC.decisions == THESIS_PPO.decisions == 600_000
    assert THESIS_PPO.learning_rate == 3e-4
    assert THESIS_PPO.variant == THESIS_SAC.variant == "thesis"


def test_the_thesis_preset_learns_its_entropy(point_env: Any) -> None:
    settings = dataclasses.replace(
        THESIS_SAC,
        extractor="vectors",
        variant="desk",
        hidden=(32, 32),
        decisions=1500,
        learning_rate=3e-3,
        batch_size=64,
        buffer_size=1500,
        evaluate_every=0,
    )
    run = TrainingRun(Training(settings, point_env, seed=0), None)
    weights, entropies = [], []
    try:
        while not run._pause():
            run._decide()
            scalars = run.learner.scalars()
            weights.append(scalars.get("train/ent_coef", 1.0))
            entropies.append(scalars.get("train/entropy", 0.0))
        target = float(run.learner.model.target_entropy)
    finally:
        run.close()
    assert target == -2.0
    assert weights[101] > 0.98
    assert weights[-1] < 0.3
    early, late = (abs(float(np.mean(part)) - target) for part in (entropies[150:350], entropies[-200:]))
    assert late < 0.5 < 2.0 < early, "the entropy must have come close to its target"


@pytest.mark.parametrize("preset", [THESIS_SAC, DESK_SAC])
def test_entropy_of_each_number_of_actions(preset: TrainingSettings, point_env: Any) -> None:
    class Motors(point_env):  # type: ignore[misc]
        action_space = gymnasium.spaces.Box(-1, 1, (21,), np.float32)

    small = {"extractor": "vectors", "variant": "desk", "hidden": (8,), "buffer_size": 64, "reset_bank_share": 0.0}
    run = TrainingRun(Training(dataclasses.replace(preset, **small), Motors, seed=0), None)
    assert run.learner.model.target_entropy == -21.0
    assert run.learner.model.ent_coef_optimizer is not None
    run.close()


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match=r"a fixed ent_coef of 1\.0 aims at no entropy"):
        dataclasses.replace(THESIS_SAC, ent_coef=1.0, target_entropy=-2.0)
    for odd in ("auto_0", "auto_-1", "auto_x", "fixed", "auto_nan"):
        with pytest.raises(ValueError, match="ent_coef must be a number, auto, or auto_ and the positive number"):
            dataclasses.replace(THESIS_SAC, ent_coef=odd)
    with pytest.raises(ValueError, match="sac does not use n_steps: leave it at 256, got 128"):
        dataclasses.replace(THESIS_SAC, n_steps=128)
    for name, value in {"target_entropy": -2.0, "buffer_size": 9, "tau": 0.5, "gradient_steps": 2.0}.items():
        with pytest.raises(ValueError, match=f"ppo does not use {name}"):
            dataclasses.replace(THESIS_PPO, **{name: value})


def test_refusals_say_why() -> None:
    with pytest.raises(ValueError, match="decisions must be greater than or equal to 1, got 0"):
        TrainingSettings(decisions=0)
    with pytest.raises(ValueError, match=r"PPO needs a number as ent_coef, got 'auto_0\.05'"):
        TrainingSettings(algorithm="ppo")
    with pytest.raises(ValueError, match="PPO keeps no replay buffer"):
        TrainingSettings(algorithm="ppo", ent_coef=0.0, demonstrations_in_replay=0.5)
    with pytest.raises(ValueError, match="unknown algorithm 'td3'; there are sac, ppo"):
        TrainingSettings(algorithm="td3")
    with pytest.raises(ValueError, match="gamma must be less than or equal to 1, got"):
        TrainingSettings(gamma=1.5)


@pytest.mark.parametrize("preset", [SMALL, dataclasses.replace(DESK_PPO, n_steps=16, batch_size=32, action_repeat=1)])
def test_learning_rate_falls_evenly_to_its_share(point_env: Any, preset: TrainingSettings) -> None:
    settings = dataclasses.replace(
        preset, decisions=400, learning_starts=0, final_learning_rate=0.1, evaluate_every=0, curve_every=100
    )
    training = Training(settings, point_env, seed=0)
    run = TrainingRun(training, None)
    rates = []
    try:
        while not run._pause():
            run._decide()
            rates.append(optimizer_of(run).param_groups[0]["lr"])
    finally:
        run.close()
    assert rates[0] > 0.9 * settings.learning_rate
    assert rates[-1] == pytest.approx(0.1 * settings.learning_rate, rel=0.5)
    assert np.all(np.diff(rates) <= 0)


def optimizer_of(run: TrainingRun) -> Any:
    model = run.learner.model
    return model.critic.optimizer if isinstance(run.learner, SacLearner) else model.policy.optimizer


def test_starts_enter_the_bank_and_validation_has_its_own_environments(point_env: Any) -> None:
    made: list[str] = []

    def named(name: str) -> Any:
        def make() -> Any:
            made.append(name)
            return point_env()

        return make

    starts = [np.full((4, 2), 0.5), np.full((2, 2), -0.5)]
    settings = dataclasses.replace(SMALL, decisions=400, evaluate_every=400, n_envs=2, reset_bank_share=0.5)
    training = Training(settings, named("training"), seed=0, starts=starts, make_validation_env=named("validation"))
    run = TrainingRun(training, None)
    assert run.sampled.reset_bank is not None
    assert len(run.sampled.reset_bank) == 6
    run.close()
    made.clear()
    training.run()
    assert made == ["training", "training", "validation", "validation"]


def test_a_few_hard_episodes_do_not_end_an_evaluation(point_env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[int] = []

    def hard_first(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, tick: Any) -> EvaluationResult:
        played.append(len(seeds))
        return EvaluationResult(tuple(EpisodeOutcome(seed - 500_000 >= 4, 9, 0.0, 1.0, 0.0, 0.0) for seed in seeds))

    monkeypatch.setattr("enn.reinforcement.best_policy.run_episodes", hard_first)
    settings = dataclasses.replace(SMALL, decisions=400, evaluate_every=400, evaluation_episodes=24)
    result = Training(settings, point_env, seed=0).run()
    assert played == [6, 18, 24]
    assert result.evaluation is not None
    assert result.evaluation["success"] == pytest.approx(20 / 24)
